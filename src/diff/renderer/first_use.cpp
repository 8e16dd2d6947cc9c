// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/first_use.hpp>

#include <algorithm>
#include <cmath>
#include <random>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "gpu/check_device.hpp"
#include "gpu/forced.hpp"
#include "gpu/trust.hpp"

namespace relidar {
namespace {

constexpr int kSurfels = 300, kRays = 256;

/// Returns surfels in a ring around the origin. Most rays hit several of them.
Surfels make_surfel_ring() {
    std::mt19937 random(1);
    const auto uniform = [&](float low, float high) {
        return low + (high - low) * float(random()) / 4294967296.0f;
    };
    Surfels surfels;
    surfels.resize(kSurfels);
    std::ranges::fill(surfels.sh, 0.0f);
    for (std::size_t i = 0; i < kSurfels; ++i) {
        const float angle = uniform(0.0f, 6.2831853f), range_m = uniform(3.0f, 30.0f);
        surfels.mean[i] = {range_m * std::cos(angle), range_m * std::sin(angle), uniform(-2.0f, 2.0f)};
        surfels.rotation[i] = {uniform(-1.0f, 1.0f), uniform(-1.0f, 1.0f), uniform(-1.0f, 1.0f),
                               uniform(0.1f, 1.0f)};
        surfels.log_scale[i] = {std::log(uniform(0.3f, 3.0f)), std::log(uniform(0.3f, 3.0f))};
        surfels.opacity_logit[i] = uniform(-1.0f, 1.0f);
    }
    return surfels;
}

WorldRays make_full_sphere_rays() {
    WorldRays rays;
    for (int i = 0; i < kRays; ++i) {
        const float angle = 6.2831853f * float(i) / kRays, up = 0.1f * float(i % 5 - 2);
        rays.origin.emplace_back(0.0f);
        rays.direction.push_back(glm::normalize(glm::vec3(std::cos(angle), std::sin(angle), up)));
    }
    return rays;
}

/// Renders the ring of surfels. If the state is `refitted`, moves the surfels by 0.2 m
/// after the tree was built, so that it is refitted.
Rendering render_surfel_ring(Device& device, const AccelOptions& accel, TreeState state) {
    Surfels surfels = make_surfel_ring();
    Renderer renderer(device, make_background_scene(surfels), {}, {.accel = accel});
    renderer.place(glm::vec3(0.0f));
    if (state == TreeState::refitted) {
        for (std::size_t i = 0; i < surfels.mean.size(); ++i) surfels.mean[i].z += i % 2 == 0 ? 0.2f : -0.2f;
        renderer.stream().finish();
        renderer.upload(surfels);
        renderer.place(glm::vec3(0.0f));
    }
    return renderer.forward(make_full_sphere_rays());
}

/// Returns the largest subgroup size that gives correct results, except the driver's
/// default size.
/// @param wrong description of the wrong result with the default size
int find_working_subgroup_size(const DeviceOptions& options, const Device& device, const std::string& wrong) {
    const std::vector<int> sizes = list_subgroup_sizes(device);
    for (auto lanes = sizes.rbegin(); lanes != sizes.rend(); ++lanes) {
        if (*lanes == device.info().subgroup_size) continue;
        const Trusting trusting(DeviceTrust{.subgroup_size = *lanes});
        Device other(options);
        if (find_wrong_subgroups(other).empty()) return *lanes;
    }
    throw DeviceError(fmt::format(
        "cannot use {} ({}): subgroups of {} lanes give wrong results ({}), and no other size is right",
        device.info().name, device.info().driver, device.info().subgroup_size, wrong));
}

}  // namespace

int count_wrong_rays(Device& device, TreeState state) {
    AccelOptions accel;
    // A test can force wrong hits here: the boxes are then smaller than their surfels.
    if (gpu::has_fault("ray_query") && device.traversal() == Traversal::ray_query) accel.margin_scale = 0.3f;
    const Rendering found = render_surfel_ring(device, accel, state);
    const Forced forced(device, {.brute_force = true});
    const Rendering expected = render_surfel_ring(device, {}, state);
    int n_wrong = 0;
    for (std::size_t i = 0; i < kRays; ++i)
        n_wrong += found.hits[i] != expected.hits[i] ||
                   !(std::abs(found.depth[i] - expected.depth[i]) <= 1e-4f * (1.0f + expected.depth[i]));
    return n_wrong;
}

DeviceTrust check_device_at_first_use(const DeviceOptions& options) {
    const Trusting trusting(DeviceTrust{});
    Device device(options);
    DeviceTrust trust;
    if (device.info().float_atomics) trust.float_atomics = compute_sum_error(device, false) == 0.0;
    trust.float_swaps = compute_sum_error(device, true) == 0.0;
    // Kernels rely on subgroups only if the device supports software traversal, so
    // subgroups are tested only then.
    if (device.info().software)
        if (const std::string wrong = find_wrong_subgroups(device); !wrong.empty())
            trust.subgroup_size = find_working_subgroup_size(options, device, wrong);
    if (device.traversal() != Traversal::ray_query) return trust;
    int n_wrong = 0;
    if (trust.subgroup_size == 0) {
        n_wrong = count_wrong_rays(device);
    } else {
        // The renderer's other kernels also need the subgroup size that passed the test.
        const Trusting trusting_size(trust);
        Device other(options);
        n_wrong = count_wrong_rays(other);
    }
    trust.ray_query = n_wrong == 0 ? Trust::right : Trust::wrong;
    return trust;
}

}  // namespace relidar
