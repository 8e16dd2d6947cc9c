// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/first_use.hpp>

#include <algorithm>
#include <cmath>
#include <optional>
#include <random>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "base/fail.hpp"
#include "gpu/check_device.hpp"
#include "gpu/forced.hpp"
#include "gpu/trust.hpp"

namespace relidar {
namespace {

constexpr int kRingSurfels = 300, kTestRays = 256;
constexpr float kFullTurnRad = 6.2831853f;

/// Returns random surfels in a ring around the origin, with ranges of 3 to 30 m. Most
/// rays hit several of them.
Surfels make_ring() {
    std::mt19937 random(1);
    const auto uniform = [&](float low, float high) {
        constexpr float kRandomRange = 4294967296.0f;  // 2^32
        return low + (high - low) * float(random()) / kRandomRange;
    };
    Surfels surfels;
    surfels.resize(kRingSurfels);
    std::ranges::fill(surfels.sh, 0.0f);
    for (std::size_t i = 0; i < kRingSurfels; ++i) {
        const float angle = uniform(0.0f, kFullTurnRad), range_m = uniform(3.0f, 30.0f);
        surfels.mean[i] = {range_m * std::cos(angle), range_m * std::sin(angle), uniform(-2.0f, 2.0f)};
        surfels.rotation[i] = {uniform(-1.0f, 1.0f), uniform(-1.0f, 1.0f), uniform(-1.0f, 1.0f),
                               uniform(0.1f, 1.0f)};
        surfels.log_scale[i] = {std::log(uniform(0.3f, 3.0f)), std::log(uniform(0.3f, 3.0f))};
        surfels.opacity_logit[i] = uniform(-1.0f, 1.0f);
    }
    return surfels;
}

WorldRays make_test_rays() {
    WorldRays rays;
    for (int i = 0; i < kTestRays; ++i) {
        const float angle = kFullTurnRad * float(i) / kTestRays, up = 0.1f * float(i % 5 - 2);
        rays.origin.emplace_back(0.0f);
        rays.direction.push_back(glm::normalize(glm::vec3(std::cos(angle), std::sin(angle), up)));
    }
    return rays;
}

/// Renders a ring of surfels around the sensor. If `tree_state` is `refitted`, moves the
/// surfels by 0.2 m after the tree was built, so that the tree is refitted.
RenderedRayValues render_ring(Device& device, const AccelOptions& accel_options, AccelTreeState tree_state) {
    Surfels surfels = make_ring();
    Renderer renderer(device, wrap_background(surfels), {}, {.accel = accel_options});
    renderer.update(glm::vec3(0.0f));
    if (tree_state == AccelTreeState::refitted) {
        // Opposite directions, so that the boxes of the tree change.
        for (std::size_t i = 0; i < surfels.mean.size(); ++i) surfels.mean[i].z += i % 2 == 0 ? 0.2f : -0.2f;
        renderer.stream().submit_and_wait();
        renderer.upload_surfels(surfels);
        renderer.update(glm::vec3(0.0f));
    }
    return renderer.render_rays(make_test_rays());
}

/// Returns the largest subgroup size that gives correct results.
/// @param error text of the wrong result with the driver's default size
int fallback_subgroup(const DeviceOptions& options, const Device& device, const std::string& error) {
    const std::vector<int> sizes = subgroup_sizes(device);
    for (auto lanes = sizes.rbegin(); lanes != sizes.rend(); ++lanes) {
        if (*lanes == device.info().subgroup_size) continue;
        // While this object exists, a new device uses its subgroup size.
        const ScopedDeviceTestResults assumed_results(DeviceTestResults{.subgroup_size = *lanes});
        Device other(options);
        if (test_subgroups(other).empty()) return *lanes;
    }
    fail<DeviceError>(
        "cannot use the device {} (driver {}): it gives wrong results with subgroups of {} lanes ({}) and "
        "with every other size of subgroups; update the driver or use another device",
        device.info().name, device.info().driver, device.info().subgroup_size, error);
}

}  // namespace

int count_wrong_rays(Device& device, AccelTreeState tree_state) {
    AccelOptions accel;
    // A test can force wrong hits here by making the boxes smaller than their surfels.
    if (gpu::has_fault("ray_query") && device.backend() == RayTracingBackend::ray_query)
        accel.margin_scale = 0.3f;
    const RenderedRayValues actual = render_ring(device, accel, tree_state);
    // Brute force tests every surfel without a tree.
    const ForcedBehaviourScope forced(device, {.brute_force = true});
    const RenderedRayValues expected = render_ring(device, {}, tree_state);
    int n_wrong = 0;
    for (std::size_t ray = 0; ray < kTestRays; ++ray) {
        const float error = std::abs(actual.depth[ray] - expected.depth[ray]);
        const bool is_depth_right = error <= 1e-4f * (1.0f + expected.depth[ray]);  // false for NaN
        if (actual.hits[ray] != expected.hits[ray] || !is_depth_right) ++n_wrong;
    }
    return n_wrong;
}

/// Tests the methods that this device would use: float atomics, subgroup operations and
/// hardware ray queries. Ray queries are tested with a subgroup size that has passed.
DeviceTestResults test_device(const DeviceOptions& options) {
    // In the scope of such an object, Device() uses its results: first the defaults.
    const ScopedDeviceTestResults defaults(DeviceTestResults{});
    Device device(options);
    DeviceTestResults results;
    if (device.info().float_atomics)
        results.float_atomics = test_atomic_adds(device, AtomicAddMethod::float_atomics) == 0.0;
    results.float_swaps = test_atomic_adds(device, AtomicAddMethod::compare_and_swap) == 0.0;
    // Only the kernels of the software ray tracer use subgroup operations.
    if (device.info().software) {
        const std::string error = test_subgroups(device);
        if (!error.empty()) results.subgroup_size = fallback_subgroup(options, device, error);
    }
    if (device.backend() != RayTracingBackend::ray_query) return results;
    const ScopedDeviceTestResults passed(results);
    std::optional<Device> other;  // only for another subgroup size
    if (results.subgroup_size != 0) other.emplace(options);
    const int n_wrong = count_wrong_rays(other ? *other : device);
    results.ray_query = n_wrong == 0 ? CheckVerdict::right : CheckVerdict::wrong;
    return results;
}

}  // namespace relidar
