// SPDX-License-Identifier: Apache-2.0
#include "diff/backward/pose_gradients.hpp"

namespace relidar {

DeviceGradients::DeviceGradients(Device& device, const DeviceScene& scene, const GradientSelection& selection,
                                 std::uint32_t n_rays)
    : surfels(device, scene.size(), "gradient", scene.surfel_parameters().parameters_used()),
      records(device, 16 * std::size_t(scene.count_rows()), "record gradient"),
      touched(device, scene.size(), "list of surfels with a gradient") {
    // Rays: dL/d(origin, direction). Poses: dL/d(translation, rotation).
    if (selection.rays) rays = {device, 6 * std::size_t(n_rays), "ray gradient"};
    if (!selection.poses) return;
    poses = {device, 6 * scene.layout().instances.size(), "pose gradient"};
    sensor = {device, 6, "sensor pose gradient"};
    pose_sums = std::make_unique<PoseGradientSums>(device, scene);
}

DeviceGradients::~DeviceGradients() = default;
DeviceGradients::DeviceGradients(DeviceGradients&&) noexcept = default;
DeviceGradients& DeviceGradients::operator=(DeviceGradients&&) noexcept = default;

}  // namespace relidar
