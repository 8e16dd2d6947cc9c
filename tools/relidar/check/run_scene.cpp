// SPDX-License-Identifier: Apache-2.0
// Checks the images of a trained scene. Some rays of a run are rendered on the device
// and, in double precision, on the CPU.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/run/stage_options.hpp>
#include "bench/case.hpp"
#include "check/checks.hpp"

#include "../../../tests/reference/render.hpp"
#include "../../../tests/support/surfels.hpp"

namespace relidar::cli {
namespace {

constexpr std::size_t kRunRays = 512;
constexpr double kValueTolerance = 1e-3;  // relative, for values above 1
// Maximum share of wrong rays, because rounding decides at edges and at equal distances.
constexpr double kEdgeShare = 0.02;

/// Selects at most kRunRays evenly spaced rays, because the reference renderer is slow.
WorldRays thin_out_rays(const WorldRays& rays) {
    WorldRays selected;
    const std::size_t n = std::min(kRunRays, rays.size());
    for (std::size_t k = 0; k < n; ++k) {
        // The middle of part k, if the rays are divided into n equal parts.
        const std::size_t i = (2 * k + 1) * rays.size() / (2 * n);
        selected.origin.push_back(rays.origin[i]);
        selected.direction.push_back(rays.direction[i]);
        selected.time_s.push_back(rays.time_s.empty() ? 0.0f : rays.time_s[i]);
    }
    return selected;
}

/// Returns true if the ray passes the centre of a surfel within four standard deviations.
/// Farther away, the opacity of a hit is too small to be blended.
bool is_near_surfel(const reference::LocalRay<double>& ray, const reference::Surfel& surfel) {
    const glm::dvec3 to_mean = surfel.mean - ray.origin;
    const double nearest_t = glm::dot(to_mean, ray.direction) / glm::dot(ray.direction, ray.direction);
    double largest_log_scale = std::max(surfel.log_scale.x, surfel.log_scale.y);
    if (surfel.log_scale_w) largest_log_scale = std::max(largest_log_scale, *surfel.log_scale_w);
    return glm::length(to_mean - nearest_t * ray.direction) <= 4.0 * std::exp(largest_log_scale);
}

/// Converts the surfels near the rays to double precision. Skips all others, because the
/// reference renderer searches every surfel for each ray. The surfels of each instance
/// are stored consecutively.
reference::World copy_near_surfels(const BenchCase& bench_case, const std::vector<reference::Ray>& rays) {
    reference::World world;
    for (std::size_t i = 0; i < bench_case.scene.instances.size(); ++i) {
        const InstancePose& pose = bench_case.placed[i];
        if (!pose.present) continue;
        const SurfelModel& model = bench_case.scene.models[bench_case.scene.instances[i].model];
        const PoseMotion& motion = pose.motion;
        reference::Placement placement{.first = std::uint32_t(world.surfels.size()),
                                       .world_from_model = pose.world_from_model,
                                       .motion = {motion.velocity_mps, motion.angular_velocity_radps,
                                                  motion.middle_s, motion.half_span_s}};
        // Each ray in the frame of the model, which may move while the sensor turns.
        std::vector<reference::LocalRay<double>> local_rays;
        for (const reference::Ray& ray : rays)
            local_rays.push_back(reference::to_model(placement.at(ray.time_s), ray));
        for (const reference::Surfel& stored :
             test::to_reference(bench_case.scene.surfels.slice(model.first, model.count))) {
            const bool walks = model.stride_m > 0.0f;  // Its surfels move with its steps.
            const reference::Surfel surfel = walks ? reference::move_to_phase(stored, pose.phase) : stored;
            if (std::ranges::any_of(local_rays, [&](const auto& ray) { return is_near_surfel(ray, surfel); }))
                world.surfels.push_back(surfel);
        }
        placement.count = std::uint32_t(world.surfels.size()) - placement.first;
        world.instances.push_back(placement);
    }
    return world;
}

/// Returns the largest difference of the values of a ray. For expected values above 1,
/// the difference is relative. NaN counts as infinite.
double ray_difference(const RenderedRayValues& rendered, std::size_t ray, const reference::Pixel& expected) {
    double worst = 0.0;
    const auto compare_value = [&](double value, double expected_value) {
        const double difference = std::abs(value - expected_value) / std::max(1.0, std::abs(expected_value));
        worst = std::isfinite(difference) ? std::max(worst, difference) : HUGE_VAL;
    };
    // Compares rendered.depth[ray] with expected.depth, and so on for each blended value.
#define RELIDAR_COMPARE(name, ...) compare_value(rendered.name[ray], expected.name);
    RELIDAR_IMAGE_VALUES(RELIDAR_COMPARE)
#undef RELIDAR_COMPARE
    compare_value(rendered.transmittance[ray], expected.transmittance);
    return worst;
}

}  // namespace

CheckResult check_run_scene(CheckedDevice& tested, RayTracingBackend backend, const BenchCase& tested_case) {
    const std::string missing = why_unsupported(tested.default_device().info(), backend);
    if (!missing.empty()) return unsupported_check("missing " + missing);
    // Renders on the device.
    const WorldRays rays = thin_out_rays(tested_case.rays);
    Renderer renderer(tested.device_with(backend), tested_case.scene, tested_case.config.image,
                      {.trace = common_options(tested_case.config), .n_rays = std::uint32_t(rays.size())});
    renderer.update(tested_case.placed, tested_case.view_origin_m);
    const RenderedRayValues rendering = renderer.render_rays(rays);

    // Renders the same rays in double precision.
    const std::vector<reference::Ray> exact_rays = test::to_reference(rays);
    const reference::World world = copy_near_surfels(tested_case, exact_rays);
    const reference::Settings settings{.image = tested_case.config.image,
                                       .view_origin = glm::dvec3(tested_case.view_origin_m)};
    const std::vector<reference::Pixel> pixels = reference::render(world, settings, exact_rays);

    std::vector<double> differences;
    for (std::size_t i = 0; i < rays.size(); ++i)
        differences.push_back(ray_difference(rendering, i, pixels[i]));
    // The negated comparison also counts NaN.
    const auto n_wrong = std::ranges::count_if(differences, [](double d) { return !(d <= kValueTolerance); });
    // Rounding decides what a ray at an edge hits, so some rays may differ.
    const double max_wrong = kEdgeShare * double(rays.size());
    std::ranges::sort(differences);
    return {
        double(n_wrong) <= max_wrong ? CheckOutcome::right : CheckOutcome::wrong,
        fmt::format("{} of {} rays differ from the reference by more than {:.0e}, expected at most "
                    "{:.0f} rays; median difference {:.1e}",
                    n_wrong, rays.size(), kValueTolerance, max_wrong, differences[differences.size() / 2])};
}

}  // namespace relidar::cli
