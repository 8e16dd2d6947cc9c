// SPDX-License-Identifier: Apache-2.0
// A random scene with a forward and a backward pass on the device, and random gradients of what its rays render.
#pragma once

#include <vector>

#include <relidar/stages/backward.hpp>
#include <relidar/stages/forward.hpp>
#include <relidar/stages/loss.hpp>

#include "../support/device.hpp"
#include "../support/gradient_check.hpp"
#include "../support/pixel_gradients.hpp"
#include "../support/placed.hpp"
#include "../support/random_scene.hpp"

namespace relidar::test {

/// Everything one forward and backward pass needs, on the device.
struct Passes {
    Device& device;
    ImageModel model;
    SceneAndPoses placed;
    Stream stream;
    DeviceScene scene;
    Accel accel;
    ForwardPass forward;
    BackwardPass backward;
    Array<DeviceRay> rays;
    Array<shared::RenderedRay> rendered;
    Array<shared::RayGradient> upstream;
    std::unique_ptr<KeptHits> kept;           ///< null: cast again
    std::unique_ptr<RayGeometry> geometry;    ///< where trace.geometry
    Gradients gradients;
    glm::vec3 view_origin;

    Passes(Device& d, const ImageModel& m, const RandomScene& s, const std::vector<reference::PixelGradient>& g, Proxy proxy, const TraceOptions& trace,
           const BackwardOptions& options = {})
        : device(d), model(m), placed(to_scene(to_surfels(s.world.surfels), s.world.instances)), stream(d, true), scene(d, placed.scene),
          accel(d, scene, {.proxy = proxy}), forward(d, m, proxy, trace), backward(d, m, proxy, trace, options), rays(d, s.rays.size(), "rays"),
          rendered(d, s.rays.size(), "rendered"), upstream(d, s.rays.size(), "upstream"),
          gradients(d, scene, {.n_rays = static_cast<std::uint32_t>(s.rays.size()), .poses = true}), view_origin(s.view_origin) {
        scene.set_poses(placed.world_from_instance);
        if (trace.geometry) geometry = std::make_unique<RayGeometry>(d, s.rays.size());
        std::vector<DeviceRay> r;
        std::vector<shared::RayGradient> u;
        std::vector<shared::GeometryGradient> q;
        for (std::size_t i = 0; i < s.rays.size(); ++i) {
            r.push_back({glm::vec3(s.rays[i].origin), glm::vec3(s.rays[i].direction)});
            u.push_back({.depth = float(g[i].depth),
                         .weight = float(g[i].weight),
                         .intensity = float(g[i].intensity),
                         .hit_logit = float(g[i].hit_logit),
                         .drop_logit = float(g[i].drop_logit)});
            q.push_back({.normal = glm::vec3(g[i].normal), .distortion = float(g[i].distortion), .point = glm::vec3(0.0f), .range = 0.0f});
        }
        rays.upload(r);
        upstream.upload(u);
        if (geometry) geometry->gradient.upload(q);
    }

    RayBatch batch() const { return {&rays, 0, 1, static_cast<std::uint32_t>(rays.size())}; }
    void run_forward() {
        scene.activate(stream, model, view_origin);
        accel.update(stream, scene);
        forward.run(stream, scene, accel, batch(), rendered, kept.get(), geometry.get());
    }
    void run_backward() { backward.run(stream, scene, accel, {batch(), &rendered, &upstream, kept.get(), geometry.get()}, view_origin, gradients); }
    void run() {
        run_forward();
        run_backward();
        stream.finish();
    }
    /// sum over rays of upstream . rendered, in double, geometry left out
    double loss() {
        run_forward();
        stream.finish();
        const std::vector<shared::RenderedRay> r = rendered.download();
        const std::vector<shared::RayGradient> u = upstream.download();
        double sum = 0.0;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            sum += double(r[i].depth) * u[i].depth + double(r[i].weight) * u[i].weight + double(r[i].intensity) * u[i].intensity;
            sum += double(r[i].hit_logit) * u[i].hit_logit + double(r[i].drop_logit) * u[i].drop_logit;
        }
        return sum;
    }
};

template <class Vector>
std::vector<double> lanes(const Vector& v, int n) {
    std::vector<double> row;
    for (int k = 0; k < n; ++k) row.push_back(v[k]);
    return row;
}

/// A row for each parameter group of each surfel, harmonics by channel.
inline void add_surfel_rows(GradientTable& table, const std::vector<reference::Surfel>& expected, const Surfels& actual) {
    for (std::size_t i = 0; i < expected.size(); ++i) {
        table.add_row("mean", lanes(expected[i].mean, 3), lanes(actual.mean[i], 3));
        table.add_row("rotation", lanes(expected[i].rotation, 4), lanes(actual.rotation[i], 4));
        table.add_row("log_scale", lanes(expected[i].log_scale, 2), lanes(actual.log_scale[i], 2));
        if (expected[i].log_scale_w) table.add_row("log_scale_w", {*expected[i].log_scale_w}, {actual.log_scale_w[i]});
        table.add_row("opacity_logit", {expected[i].opacity_logit}, {actual.opacity_logit[i]});
        const char* names[] = {"sh intensity", "sh hit", "sh drop"};
        for (int c = 0; c < kShChannels; ++c)
            table.add_row(names[c], lanes(expected[i].sh.data() + c * kShCoefficients, kShCoefficients), lanes(actual.sh.data() + i * kShFloats + std::size_t(c * kShCoefficients), kShCoefficients));
    }
}

}  // namespace relidar::test
