// SPDX-License-Identifier: Apache-2.0
// Example: trains a run with a user-defined loss. The loss consists of a robust loss of
// ranges, log(1 + (error / 0.2 m)^2), and the cross-entropy of ray drops.
#include <cmath>
#include <cstdio>

#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/relidar.hpp>

using namespace relidar;

/// Returns the mean loss of all rays. Writes the derivatives of the loss with respect to
/// the rendered values to `gradients`.
double loss_gradients(const RenderedRayValues& rendering, const Scan& measured_scan,
                      RenderedGradients& gradients) {
    const std::size_t n = rendering.size();
    gradients = {
        std::vector<float>(n), std::vector<float>(n), {}, std::vector<float>(n), std::vector<float>(n)};
    double loss = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        const bool returned = measured_scan.range_m[i] > 0.0f;
        const float weight = rendering.weight[i],
                    drop = 1.0f / (1.0f + std::exp(rendering.hit_logit[i] - rendering.drop_logit[i]));
        loss -= std::log(std::max(returned ? 1.0f - drop : drop, 1e-6f)) / double(n);
        gradients.drop_logit[i] = (drop - (returned ? 0.0f : 1.0f)) / float(n);
        gradients.hit_logit[i] = -gradients.drop_logit[i];
        if (!returned || weight < 0.1f) continue;
        const float error =
            // Rendered minus measured range, in units of 0.2 m. `depth` is a weighted sum
            // over surfels and is divided by the total weight.
            (rendering.depth[i] / weight - measured_scan.range_m[i]) / 0.2f;
        loss += std::log1p(double(error) * double(error)) / double(n);
        gradients.depth[i] = 2.0f * error / (1.0f + error * error) / 0.2f / float(n) / weight;
        gradients.weight[i] = -gradients.depth[i] * rendering.depth[i] / weight;
    }
    return loss;
}

int main(int argc, char** argv) try {
    if (argc != 2) {
        std::fprintf(stderr, "usage: %s DRIVE\n", argv[0]);
        return 2;
    }
    const Log log = load_sequence(argv[1], {});
    const PoseTrack trajectory = log.lidar_track(0);
    const Split split = split_frames(log, 10);
    const Scene scene = init_scene(log, split.train, {});
    Device device;
    DifferentiableRenderer differentiable(device, scene, ImageModel{});
    Renderer& renderer = differentiable.renderer();
    Adam adam(device, static_cast<std::uint32_t>(scene.surfels.size()), {});
    RenderedGradients d;
    double first = 0.0, last = 0.0;
    for (int step = 1; step <= 40; ++step) {
        // Selects the frame of this step. Each frame is used for ten steps.
        const Frame& frame =
            log.frames[std::size_t(split.train[std::size_t(step / 10) % split.train.size()])];
        WorldRays rays;
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const WorldRay ray =
                make_world_ray(trajectory, frame.time_s, frame.scan.rays, i, log.rolling_shutter);
            rays.origin.push_back(glm::vec3(ray.origin_m));
            rays.direction.push_back(glm::vec3(ray.direction));
            rays.time_s.push_back(log.rolling_shutter ? frame.scan.rays.time_offset_s[i] : 0.0f);
        }
        renderer.update(pose_instances(scene, log, timing_of(frame)),
                        glm::vec3(trajectory.pose_at(frame.time_s).translation));
        last = loss_gradients(renderer.render_rays(rays), frame.scan, d);
        differentiable.backpropagate(d);
        adam.record_step(renderer.stream(), renderer.scene().surfel_parameters(),
                         differentiable.gradients().surfels, &differentiable.gradients().touched, {}, step,
                         3);
        if (step == 1) first = last;
    }
    std::printf("loss %.4f -> %.4f\n", first, last);
    return last < first ? 0 : 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
