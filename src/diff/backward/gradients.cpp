// SPDX-License-Identifier: Apache-2.0
// Allocates the device arrays for all requested gradients.
#include "diff/backward/pose_gradients.hpp"

namespace relidar {

Gradients::Gradients(Device& device, const DeviceScene& scene, const GradientSelection& selection,
                     std::uint32_t n_rays)
    : surfels(device, scene.size(), "gradient", scene.parameters().parameters()),
      records(device, 16 * std::size_t(scene.gradient_rows()), "record gradient"),
      touched(device, scene.size(), "touched surfels") {
    if (selection.rays) rays = {device, 6 * std::size_t(n_rays), "ray gradient"};
    if (!selection.poses) return;
    poses = {device, 6 * scene.layout().instances.size(), "pose gradient"};
    sensor = {device, 6, "sensor pose gradient"};
    pose_sums = std::make_unique<PoseSums>(device, scene);
}

Gradients::~Gradients() = default;
Gradients::Gradients(Gradients&&) noexcept = default;
Gradients& Gradients::operator=(Gradients&&) noexcept = default;

}  // namespace relidar
