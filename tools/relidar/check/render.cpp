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
#include "../../../tests/support/random_scene.hpp"
#include "../../../tests/support/surfels.hpp"

namespace relidar::cli {
namespace {

struct RenderAndGradients {
    test::RandomScene scene;
    reference::Settings settings;
    std::vector<reference::PixelGradient> upstream;
    RenderedRayValues rendering;
    Surfels gradients;
};

/// Converts gradients of all values that are blended along a ray to the device's format.
std::vector<shared::RayGradient> to_ray_gradients(const std::vector<reference::PixelGradient>& gradients) {
    std::vector<shared::RayGradient> converted(gradients.size());
    for (std::size_t i = 0; i < converted.size(); ++i) {
#define RELIDAR_COPY(name, ...) converted[i].name = float(gradients[i].name);
        RELIDAR_BLENDED_VALUES(RELIDAR_COPY)
#undef RELIDAR_COPY
    }
    return converted;
}

/// Renders a random scene and computes the gradients of all surfels for random gradients
/// of the image ("upstream").
RenderAndGradients run_passes(Device& device) {
    RenderAndGradients pass;
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
    differentiable.last_batch().upstream->upload(to_ray_gradients(pass.upstream));
    renderer.update(placed.world_from_instance, glm::vec3(pass.scene.view_origin));
    renderer.record_forward({.rays = &rays, .n_rays = n_rays});
    differentiable.record_backward();
    pass.rendering = renderer.download_rays();
    pass.gradients = differentiable.gradients().surfels.download();
    return pass;
}

template <class Vector>
std::vector<double> to_doubles(const Vector& vector, int n_values) {
    std::vector<double> row;
    for (int k = 0; k < n_values; ++k) row.push_back(vector[k]);
    return row;
}

/// Returns the largest relative error of the surfel gradients, compared with the
/// gradients of the reference renderer.
double gradient_error(const RenderAndGradients& pass) {
    const reference::Gradients expected =
        reference::backward(pass.scene.world, pass.settings, pass.scene.rays, pass.upstream);
    test::GradientTable rows;
    const Surfels& actual = pass.gradients;
    for (std::size_t i = 0; i < expected.surfels.size(); ++i) {
        const reference::Surfel& s = expected.surfels[i];
        rows.add_row("mean", to_doubles(s.mean, 3), to_doubles(actual.mean[i], 3));
        rows.add_row("rotation", to_doubles(s.rotation, 4), to_doubles(actual.rotation[i], 4));
        rows.add_row("log_scale", to_doubles(s.log_scale, 2), to_doubles(actual.log_scale[i], 2));
        rows.add_row("opacity_logit", {s.opacity_logit}, {actual.opacity_logit[i]});
        // The coefficients of all surfels are stored in one array.
        rows.add_row("sh", to_doubles(s.sh, kShFloats),
                     to_doubles(actual.sh.data() + i * kShFloats, kShFloats));
    }
    return rows.compute_worst_error();
}

/// Returns the root mean square error of the rendered values, relative to the root mean
/// square of the exact values: sqrt(sum (rendered - exact)^2 / sum exact^2).
double image_error(const RenderAndGradients& pass) {
    const std::vector<reference::Pixel> pixels =
        reference::render(pass.scene.world, pass.settings, pass.scene.rays);
    double sum_squared_errors = 0.0, sum_squares = 0.0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
        const reference::Pixel& p = pixels[i];
        const auto add_value = [&](double actual, double expected) {
            sum_squared_errors += (actual - expected) * (actual - expected);
            sum_squares += expected * expected;
        };
        // A call for each value that is blended along a ray, such as the depth.
#define RELIDAR_ADD(name, ...) add_value(pass.rendering.name[i], p.name);
        RELIDAR_IMAGE_VALUES(RELIDAR_ADD)
#undef RELIDAR_ADD
        add_value(pass.rendering.transmittance[i], p.transmittance);
    }
    return std::sqrt(sum_squared_errors / sum_squares);
}

}  // namespace

std::string why_unsupported(const DeviceInfo& device_info, RayTracingBackend backend) {
    return backend == RayTracingBackend::ray_query ? device_info.why_not_ray_query
                                                   : device_info.why_not_software;
}

/// Compares the hits of rays in the acceleration tree with a search of all surfels.
CheckResult check_ray_hits(CheckedDevice& tested, RayTracingBackend backend) {
    const std::string missing = why_unsupported(tested.default_device().info(), backend);
    if (!missing.empty()) return unsupported_check("missing " + missing);
    Device& device = tested.device_with(backend);
    const int n_wrong_built = count_wrong_rays(device, AccelTreeState::built),
              n_wrong_refitted = count_wrong_rays(device, AccelTreeState::refitted);
    if (n_wrong_built + n_wrong_refitted == 0)
        return passed_check("all rays hit the same surfels as in a search of all surfels");
    return failed_check(
        fmt::format("rays with other hits than in a search of all surfels: {} of 256 after the acceleration "
                    "tree was built, {} of 256 after the tree was refitted",
                    n_wrong_built, n_wrong_refitted));
}

/// Compares image and gradients of a random scene with the reference renderer.
CheckResult check_gradients(CheckedDevice& tested, RayTracingBackend backend) {
    const std::string missing = why_unsupported(tested.default_device().info(), backend);
    if (!missing.empty()) return unsupported_check("missing " + missing);
    const RenderAndGradients pass = run_passes(tested.device_with(backend));
    // kKernelNmse limits the squared error, so its root limits image_error().
    const CheckResult image = compare_error(image_error(pass), std::sqrt(test::kKernelNmse)),
                      gradient = compare_error(gradient_error(pass), test::kKernelGradient);
    // The worse of both outcomes: `right` is less than `wrong`.
    return {std::max(image.kind, gradient.kind),
            fmt::format("image: {}; gradients: {}", image.text, gradient.text)};
}

}  // namespace relidar::cli
