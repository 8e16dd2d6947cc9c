// SPDX-License-Identifier: Apache-2.0
#include "simulate/scan_files/placed_scan.hpp"

#include <relidar/base/float_step.hpp>
#include <relidar/simulate/place_points.hpp>

namespace relidar::scan_files {

std::vector<double> row_major(const Pose& pose) {
    const glm::dmat4 columns = to_matrix(pose);
    std::vector<double> numbers;
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column) numbers.push_back(columns[column][row]);
    return numbers;
}

std::optional<Pose> world_from_output(const ScanOutputOptions& format, const Pose& world_from_deskewed) {
    if (format.frame == PointCoordinateFrame::world && format.map)
        return format.map->dataset_from_axes(format.world_offset_m);
    if (format.frame == PointCoordinateFrame::world) return Pose{{1, 0, 0, 0}, points_origin_m(format)};
    return format.deskew ? std::optional(world_from_deskewed) : std::nullopt;
}

ScanInOutputFrame::ScanInOutputFrame(const RenderedScan& rendered, const ScanOutputOptions& options,
                                     int frame_number, FileMetadata file_notes)
    : scan(rendered),
      format(options),
      frame(frame_number),
      notes(std::move(file_notes)),
      dataset_from_points_(world_from_output(options, rendered.world_from_sensor)) {}

const PlacedRays& ScanInOutputFrame::rays() {
    if (rays_) return *rays_;
    // One end per ray, also without a return.
    LidarPoints ends = place_points(scan, format.config, dataset_from_points_, PointSelection::rays);
    rays_ = {scan.image.origin, scan.image.direction, std::move(ends.position_m), scan.channels};
    if (!dataset_from_points_) return *rays_;
    for (std::size_t k = 0; k < rays_->channels.size(); ++k)
        rays_->channels[k].values = std::move(ends.channels[k].values);
    // Converts each ray from the sensor frame at its firing time to the common frame.
    FiringPoseInterpolator target(scan, inverse(*dataset_from_points_));
    for (std::size_t i = 0; i < rays_->origin.size(); ++i) {
        const Pose& target_from_firing = target.pose_of(i);
        glm::vec3 &origin = rays_->origin[i], &direction = rays_->direction[i];
        origin = glm::vec3(target_from_firing * glm::dvec3(origin));
        direction = glm::vec3(glm::normalize(target_from_firing.rotation * glm::dvec3(direction)));
    }
    return *rays_;
}

std::optional<glm::dvec3> ScanInOutputFrame::world_origin_m() const {
    if (format.frame == PointCoordinateFrame::sensor) return {};
    if (format.map) return format.map->to_map(format.world_offset_m);
    return points_origin_m(format);
}

const LidarPoints& ScanInOutputFrame::points() {
    if (points_) return *points_;
    points_ = place_points(scan, format.config, dataset_from_points_);
    // So far, the map was a plane at its origin.
    if (format.frame == PointCoordinateFrame::world && format.map)
        format.map->project_points(points_->position_m, *dataset_from_points_);
    return *points_;
}

}  // namespace relidar::scan_files

namespace relidar {

glm::dvec3 points_origin_m(const ScanOutputOptions& options) {
    constexpr double kMaxStep_m = 0.5e-3;
    const glm::dvec3 size_m = glm::abs(options.world_offset_m);
    const double farthest_m = std::max({size_m.x, size_m.y, size_m.z});
    return float_step_m(farthest_m) > kMaxStep_m ? options.world_offset_m : glm::dvec3(0.0);
}

}  // namespace relidar
