// SPDX-License-Identifier: Apache-2.0
// Checks the triangles or boxes that bound surfels ("proxies", kernel diff/accel/proxies)
// and the acceleration structure (M3, Fig. 3).
#include <algorithm>
#include <bit>
#include <cmath>

#include <relidar/diff/forward.hpp>
#include "scene/benchmark_street.hpp"

#include "../../support/device.hpp"
#include "diff/shared/accel.h"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

class Proxies : public test::DeviceTest {};

Surfels make_one_surfel(float opacity) {
    Surfels s;
    s.resize(1);
    s.mean[0] = {10.0f, 0.0f, 0.0f};
    s.rotation[0] = {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f};  // a_u = -z, a_v = y, normal = x
    s.log_scale[0] = {std::log(0.5f), std::log(0.25f)};
    s.opacity_logit[0] = std::log(opacity / (1.0f - opacity));
    std::fill(s.sh.begin(), s.sh.end(), 0.0f);
    return s;
}

/// Returns a 3D Gaussian with the outline of make_one_surfel() when it is viewed along x
/// (second and third scale). It is 2 m long along the rays.
Surfels make_one_gaussian(float opacity) {
    Surfels s = make_one_surfel(opacity);
    s.rotation[0] = {1.0f, 0.0f, 0.0f, 0.0f};
    s.log_scale[0] = {std::log(2.0f), std::log(0.25f)};
    s.log_scale_w = {std::log(0.5f)};
    s.primitive = PrimitiveType::gaussian;
    return s;
}

/// Returns parallel rays along x around the rim of a surfel. The rays pass the points k
/// (cos, sin) on the ellipse sigma G = alpha_min, scaled by `factor`.
WorldRays make_rim_rays(float opacity, double factor, double alpha_min = 1.0 / 255.0) {
    const double k = std::sqrt(2.0 * std::log(opacity / alpha_min)) * factor;
    WorldRays rays;
    for (int i = 0; i < 360; ++i) {
        const double angle = i * kPi / 180.0;
        rays.origin.push_back({0.0f, float(0.25 * k * std::sin(angle)), float(0.5 * k * std::cos(angle))});
        rays.direction.push_back({1.0f, 0.0f, 0.0f});
    }
    return rays;
}

/// Tests the kernel diff/accel/model_radii. The rim of every ellipse must be within the
/// radius of its model, and the radius must not be much larger than necessary.
TEST_F(Proxies, ModelRadiiHoldEverythingThatCanBeSeen) {
    constexpr std::uint32_t kFirst = 150, kAll = 230;  // more surfels than a single thread processes
    constexpr double kAlphaMin = 1.0 / 255.0;
    Surfels surfels = make_street_surfels(kAll);
    for (std::uint32_t i = 0; i < kAll; i += 3) surfels.opacity_logit[i] = 2.0f;
    surfels.opacity_logit[7] = -20.0f;
    surfels.mean[7] = {1e4f, 0.0f, 0.0f};  // too transparent to be hit
    Scene scene = wrap_background(surfels);
    scene.models = {{"background", 0, kFirst}, {"actor", kFirst, kAll - kFirst}};
    DeviceScene on_device(device(), scene);
    Stream stream(device());
    on_device.activate(stream, {}, glm::vec3(0.0f));
    Kernel<shared::ModelRadiiParams> kernel(device(), "diff/accel/model_radii");
    const Array<std::uint32_t, shared::ModelRadii> radii(device(), 2, "radii");
    stream.fill(radii);
    run(stream, kernel, (kAll + RELIDAR_RADIUS_STRETCH - 1) / RELIDAR_RADIUS_STRETCH,
        {.records = on_device.surfel_records().address(),
         .models = on_device.model_table().address(),
         .radii = radii.address(),
         .alpha_min = float(kAlphaMin),
         .margin_m = 0.0f,
         .margin_scale = 1.0f,
         .n_models = 2,
         .first_surfel = 0,
         .n_surfels = kAll});
    stream.submit_and_wait();
    const std::vector<std::uint32_t> actual = radii.download();
    for (const std::uint32_t m : {0u, 1u}) {
        double expected = 0.0;
        for (std::uint32_t i = scene.models[m].first; i < scene.models[m].first + scene.models[m].count;
             ++i) {
            const double opacity = 1.0 / (1.0 + std::exp(-double(surfels.opacity_logit[i])));
            if (opacity <= kAlphaMin) continue;
            const double largest = std::exp(double(std::max(surfels.log_scale[i].x, surfels.log_scale[i].y)));
            expected = std::max(expected, double(glm::length(surfels.mean[i])) +
                                              std::sqrt(2.0 * std::log(opacity / kAlphaMin)) * largest);
        }
        EXPECT_NEAR(double(std::bit_cast<float>(actual[m])), expected, 1e-5 * expected) << "model " << m;
    }
}

/// Rays just inside of the rim must hit, and rays just outside must not.
void expect_rim(Device& device, const Surfels& surfel, float opacity, const ImageModel& model = {}) {
    for (const ProxyShape proxy : {ProxyShape::triangles, ProxyShape::boxes}) {
        Renderer renderer(device, wrap_background(surfel), model, {.accel = {.proxy = proxy}});
        renderer.update(glm::vec3(0.0f));
        for (const auto& [factor, expected] : {std::pair{0.999, 1u}, {1.001, 0u}})
            for (const std::uint32_t n :
                 renderer.render_rays(make_rim_rays(opacity, factor, double(model.alpha_min))).hits)
                EXPECT_EQ(n, expected) << "opacity " << opacity << ", alpha_min " << model.alpha_min;
    }
}

TEST_F(Proxies, HoldEverythingThatCanBeSeen) {
    for (const float opacity : {0.005f, 0.1f, 0.6f, 0.999f})
        expect_rim(device(), make_one_surfel(opacity), opacity);
    for (const float opacity : {0.005f, 0.1f, 0.999f})
        expect_rim(device(), make_one_gaussian(opacity), opacity, {.primitive = PrimitiveType::gaussian});
    for (const float alpha_min : {1e-4f, 0.05f})
        expect_rim(device(), make_one_surfel(0.6f), 0.6f, {.alpha_min = alpha_min});
    // A surfel whose opacity is below the smallest blended opacity has no proxy.
    Renderer renderer(device(), wrap_background(make_one_surfel(1.0f / 256.0f)), {});
    renderer.update(glm::vec3(0.0f));
    for (const std::uint32_t n : renderer.render_rays(make_rim_rays(0.5f, 0.1)).hits) EXPECT_EQ(n, 0u);
}

TEST_F(Proxies, RefitFollowsMovedSurfelsAndMovingInstancesBuildsNothing) {
    for (const ProxyShape proxy : {ProxyShape::triangles, ProxyShape::boxes}) {
        Stream stream(device());
        DeviceScene scene(device(), wrap_background(make_one_surfel(0.9f)));
        AccelerationStructure accel(device(), scene, {.proxy = proxy});
        ForwardPass forward(device(), {}, accel.proxy_shape(), {});
        const Array<DeviceRay> ray(device(), std::vector<DeviceRay>{{{0, 0, 0}, {1, 0, 0}}}, "ray");
        Array<shared::RenderedRay> rendered(device(), 1, "rendered");
        const auto depth = [&] {
            forward.record_forward(stream, scene, accel, {&ray, 0, 1, 1}, rendered);
            stream.submit_and_wait();
            const shared::RenderedRay r = rendered.download()[0];
            return r.depth / r.weight;
        };
        scene.activate(stream, {}, glm::vec3(0.0f));
        accel.record_refit(stream, scene);
        EXPECT_NEAR(depth(), 10.0f, 1e-5f);
        Surfels moved = make_one_surfel(0.9f);
        moved.mean[0].x = 4.0f;
        scene.surfel_parameters().upload(moved);
        scene.activate(stream, {}, glm::vec3(0.0f));
        accel.record_refit(stream, scene);
        EXPECT_NEAR(depth(), 4.0f, 1e-5f);
        const std::uint64_t updates = accel.n_updates();
        Pose pose;
        pose.translation.x = 3.0;
        scene.upload_poses({pose});
        accel.record_top_level(stream, scene);
        EXPECT_NEAR(depth(), 7.0f, 1e-5f);
        EXPECT_EQ(accel.n_updates(), updates);
    }
}

}  // namespace
}  // namespace relidar
