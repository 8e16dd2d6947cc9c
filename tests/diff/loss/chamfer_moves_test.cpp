// SPDX-License-Identifier: Apache-2.0
// Checks that training uses the gradient of the Chamfer loss. With only this loss, the
// backward pass and Adam must move a displaced wall of surfels back to its measured
// position. If the gradient is cut off, the wall must not move.
#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/optimizer.hpp>

#include "../../support/device.hpp"

namespace relidar {
namespace {

class ChamferMoves : public test::DeviceTest {};

constexpr float kWall_m = 6.0f, kShift_m = 0.4f;

/// Makes a wall at x = kWall_m + shift that faces the sensor. Its surfels are 0.25 m
/// apart and have a low drop probability.
Scene wall(float shift) {
    Surfels s;
    s.resize(20 * 20);
    for (std::size_t i = 0; i < s.size(); ++i) {
        s.mean[i] = {kWall_m + shift, 0.25f * (float(i % 20) - 9.5f), 0.25f * (float(i / 20) - 9.5f)};
        s.rotation[i] = {0.70710678f, 0.0f, 0.70710678f, 0.0f};  // the normal along x
        s.log_scale[i] = glm::vec2(std::log(0.15f));
        s.opacity_logit[i] = 3.0f;
        s.sh[i * kShFloats + kShCoefficients] = 5.0f;
    }
    return wrap_background(s);
}

void measure_wall(std::uint32_t side, std::vector<DeviceRay>& rays, std::vector<DeviceTarget>& targets) {
    for (std::uint32_t i = 0; i < side * side; ++i) {
        const glm::vec3 d = glm::normalize(glm::vec3(1.0f, 0.6f * (float(i % side) / float(side - 1) - 0.5f),
                                                     0.6f * (float(i / side) / float(side - 1) - 0.5f)));
        rays.push_back({glm::vec3(0.0f), d, 0.0f});
        targets.push_back({kWall_m / d.x, 0.5f, 1.0f});
    }
}

/// Trains for some steps with only the Chamfer loss. Returns the mean distance between
/// the means of visible surfels and the measured wall.
double measure_distance_after(Device& device, float shift, bool cut_gradient, bool image) {
    constexpr std::uint32_t kSide = 24, kRays = kSide * kSide;
    std::vector<DeviceRay> rays;
    std::vector<DeviceTarget> targets;
    measure_wall(kSide, rays, targets);
    const Array<DeviceRay> device_rays(device, rays, "rays");
    const Array<DeviceTarget> device_targets(device, targets, "targets");
    LossWeights weights;
    weights.depth = weights.intensity = weights.drop = 0.0f;
    weights.chamfer = 1.0f;
    weights.normalised_depth = true;
    DifferentiableRenderer differentiable(device, wall(shift), {}, {.n_rays = kRays});
    Renderer& renderer = differentiable.renderer();
    const std::vector<std::unique_ptr<Loss>> losses = make_losses(device, weights, kRays);
    Adam adam(device, renderer.scene().size(), {});
    const Array<float> terms(device, std::vector<float>(kLossTerms, 0.0f), "terms");
    const RayBatch batch{&device_rays, 0, 1, kRays};
    const TargetBatch measured{
        &device_targets, 0, 1, kRays, kRays, kRays, image ? ImageShape{kSide, kSide, false} : ImageShape{}};
    for (int step = 1; step <= 60; ++step) {
        renderer.update(glm::vec3(0.0f));
        renderer.record_forward(batch);
        for (const std::unique_ptr<Loss>& loss : losses)
            loss->add_ray_losses(renderer.stream(), differentiable.last_batch(), measured, terms);
        if (cut_gradient) renderer.stream().fill(*differentiable.last_batch().upstream);
        differentiable.record_backward();
        const DeviceGradients& gradients = differentiable.gradients();
        adam.record_step(renderer.stream(), renderer.scene().surfel_parameters(), gradients.surfels,
                         &gradients.touched, {0.02, 0.0, 0.0, 0.0, 0.0, 1.0}, step, 3);
        renderer.stream().submit_and_wait();
    }
    double sum = 0.0, n = 0.0;
    for (const glm::vec3& m : renderer.download_scene().surfels.mean) {
        if (std::abs(m.y) > 1.5f || std::abs(m.z) > 1.5f) continue;  // outside the rays
        sum += std::abs(m.x - kWall_m);
        n += 1.0;
    }
    return sum / n;
}

TEST_F(ChamferMoves, AWallComesBackToWhereItWasMeasured) {
    EXPECT_LT(measure_distance_after(device(), kShift_m, false, true), 0.2 * kShift_m)
        << "from behind, an image";
    EXPECT_LT(measure_distance_after(device(), -kShift_m, false, false), 0.2 * kShift_m)
        << "from the front, no image";
    EXPECT_NEAR(measure_distance_after(device(), kShift_m, true, true), kShift_m, 1e-4)
        << "without the gradient nothing moves";
}

}  // namespace
}  // namespace relidar
