// SPDX-License-Identifier: Apache-2.0
// Checks the bounding volume hierarchies, the rendered images and the gradients of a
// random scene.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/first_use.hpp>
#include "check/checks.hpp"
#include "gpu/forced.hpp"

#include "../../../tests/support/gradient_check.hpp"
#include "../../../tests/support/pixel_gradients.hpp"
#include "../../../tests/support/placed.hpp"
#include "../../../tests/support/random_scene.hpp"

namespace relidar::cli {
namespace {

/// Rendered images and gradients of a random scene.
struct Pass {
    test::RandomScene scene;
    reference::Settings settings;
    std::vector<reference::PixelGradient> upstream;
    Rendering rendering;
    Surfels gradients;
};

Pass run_pass(Device& device) {
    Pass pass;
    test::RandomSceneOptions options;
    options.seed = 21;
    options.actor_instances = 1;
    options.rays = 100;
    pass.settings.image.sh_direction = ShDirection::surfel;
    pass.scene = test::make_random_scene(options, pass.settings);
    pass.settings.view_origin = pass.scene.view_origin;
    pass.upstream = test::make_random_upstream(pass.scene.rays.size(), options.seed);
    const test::SceneAndPoses placed =
        test::to_scene(test::to_surfels(pass.scene.world.surfels), pass.scene.world.instances);
    const auto n_rays = static_cast<std::uint32_t>(pass.scene.rays.size());
    DifferentiableRenderer differentiable(device, placed.scene, pass.settings.image, {.n_rays = n_rays});
    Renderer& renderer = differentiable.renderer();
    const Array<DeviceRay> rays(
        device, std::span<const DeviceRay>(to_device_rays(test::to_world_rays(pass.scene.rays))), "rays");
    std::vector<shared::RayGradient> upstream(n_rays);
    for (std::size_t i = 0; i < upstream.size(); ++i) {
#define RELIDAR_COPY(name, built, value, input, slope, meaning) \
    upstream[i].name = float(pass.upstream[i].name);
        RELIDAR_BLENDED_VALUES(RELIDAR_COPY)
#undef RELIDAR_COPY
    }
    differentiable.batch().upstream->upload(upstream);
    renderer.place(placed.world_from_instance, glm::vec3(pass.scene.view_origin));
    renderer.record_forward({&rays, 0, 1, n_rays});
    differentiable.record_backward();
    pass.rendering = renderer.download_rendering();
    pass.gradients = differentiable.gradients().surfels.download();
    return pass;
}

template <class Vector>
std::vector<double> convert_to_doubles(const Vector& values, int count) {
    std::vector<double> row;
    for (int k = 0; k < count; ++k) row.push_back(values[k]);
    return row;
}

double measure_gradient_error(const Pass& pass, const reference::BruteForce& brute) {
    reference::Gradients expected(pass.scene.world);
    for (std::size_t i = 0; i < pass.scene.rays.size(); ++i)
        reference::backward(pass.scene.world, brute, pass.settings, pass.scene.rays[i], 16, pass.upstream[i],
                            expected);
    test::GradientTable rows;
    const Surfels& actual = pass.gradients;
    for (std::size_t i = 0; i < expected.surfels.size(); ++i) {
        const reference::Surfel& s = expected.surfels[i];
        rows.add_row("mean", convert_to_doubles(s.mean, 3), convert_to_doubles(actual.mean[i], 3));
        rows.add_row("rotation", convert_to_doubles(s.rotation, 4),
                     convert_to_doubles(actual.rotation[i], 4));
        rows.add_row("log_scale", convert_to_doubles(s.log_scale, 2),
                     convert_to_doubles(actual.log_scale[i], 2));
        rows.add_row("opacity_logit", {s.opacity_logit}, {actual.opacity_logit[i]});
        rows.add_row("sh", convert_to_doubles(s.sh, kShFloats),
                     convert_to_doubles(actual.sh.data() + i * kShFloats, kShFloats));
    }
    return rows.compute_worst_error();
}

double measure_image_error(const Pass& pass, const reference::BruteForce& brute) {
    double error = 0.0, power = 0.0;
    for (std::size_t i = 0; i < pass.scene.rays.size(); ++i) {
        const reference::Pixel p =
            reference::render(pass.scene.world, brute, pass.settings, pass.scene.rays[i], 16);
        const auto add = [&](double actual, double expected) {
            error += (actual - expected) * (actual - expected);
            power += expected * expected;
        };
#define RELIDAR_ADD(name, built, value, input, slope, meaning) add(pass.rendering.name[i], p.name);
        RELIDAR_IMAGE_VALUES(RELIDAR_ADD)
#undef RELIDAR_ADD
        add(pass.rendering.transmittance[i], p.transmittance);
    }
    return std::sqrt(error / power);
}

}  // namespace

std::string explain_unsupported(const DeviceInfo& info, Traversal traversal) {
    return traversal == Traversal::ray_query ? info.why_not_ray_query : info.why_not_software;
}

Finding check_tree(CheckedDevice& checked, Traversal traversal) {
    const std::string missing = explain_unsupported(checked.device().info(), traversal);
    if (!missing.empty()) return make_unsupported_finding("missing " + missing);
    const int n_built = count_wrong_rays(checked.with(traversal), TreeState::built),
              n_refitted = count_wrong_rays(checked.with(traversal), TreeState::refitted);
    if (n_built + n_refitted == 0) return {Finding::Kind::right, "all rays find the same surfels"};
    return make_wrong_finding(
        fmt::format("{} of 256 rays find other surfels after a build of the tree, and {} after a "
                    "refit",
                    n_built, n_refitted));
}

Finding check_render(CheckedDevice& checked, Traversal traversal) {
    const std::string missing = explain_unsupported(checked.device().info(), traversal);
    if (!missing.empty()) return make_unsupported_finding("missing " + missing);
    const Pass pass = run_pass(checked.with(traversal));
    const reference::BruteForce brute(pass.scene.world, pass.settings.image,
                                      reference::Precision::double_record);
    const Finding image = judge(measure_image_error(pass, brute), std::sqrt(test::kKernelNmse)),
                  gradient = judge(measure_gradient_error(pass, brute), test::kKernelGradient);
    return {std::max(image.kind, gradient.kind),
            fmt::format("image: {}; gradients: {}", image.text, gradient.text)};
}

}  // namespace relidar::cli
