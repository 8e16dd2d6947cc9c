// SPDX-License-Identifier: Apache-2.0
#include <limits>

#include <relidar/render.hpp>

namespace relidar {

FiringPoses::FiringPoses(const RenderedScan& scan, const Pose& target_from_dataset)
    : scan_(scan), target_from_dataset_(target_from_dataset) {
    const bool stands = scan.track.pose.size() < 2, in_rows = scan.image.rows > 1 && scan.image.columns > 0;
    made_.assign(in_rows && !stands ? std::size_t(scan.image.columns) : 1, {std::numeric_limits<float>::quiet_NaN(), {}});
    if (stands && !scan.time_offset_s.empty()) made_[0].target_from_firing = target_from_dataset * scan.world_from_firing(0);
}

const Pose& FiringPoses::at(std::size_t ray) {
    Made& made = made_[ray % made_.size()];
    if (scan_.track.pose.size() >= 2 && made.time_offset_s != scan_.time_offset_s[ray])
        made = {scan_.time_offset_s[ray], target_from_dataset_ * scan_.world_from_firing(ray)};
    return made.target_from_firing;
}

}  // namespace relidar
