// SPDX-License-Identifier: Apache-2.0

#include <relidar/simulate/render.hpp>

namespace relidar {

FiringPoseInterpolator::FiringPoseInterpolator(const RenderedScan& scan, const Pose& target_from_dataset)
    : scan_(scan),
      target_from_dataset_(target_from_dataset),
      moves_(scan.track.pose.size() > 1),
      made_(moves_ && scan.image.rows > 1 ? std::size_t(scan.image.columns) : 1,
            {std::numeric_limits<float>::quiet_NaN(), {}}) {}

const Pose& FiringPoseInterpolator::pose_of(std::size_t ray) {
    CachedFiringPose& made = made_[ray % made_.size()];
    const float time_offset_s = moves_ ? scan_.time_offset_s[ray] : 0.0f;
    if (made.time_offset_s != time_offset_s)
        made = {time_offset_s, target_from_dataset_ * scan_.firing_pose(ray)};
    return made.target_from_firing;
}

}  // namespace relidar
