// SPDX-License-Identifier: Apache-2.0
#include "placed_scan.hpp"

#include <utility>

#include <relidar/simulate/place_points.hpp>

namespace relidar::scan_files {
std::optional<Pose> compute_output_frame_pose(const ScanFormat& format, const Pose& world_from_deskewed) {
    if (format.frame == PointFrame::world) return Pose{};
    return format.deskew ? std::optional(world_from_deskewed) : std::nullopt;
}

PlacedScan make_placed_scan(const RenderedScan& scan, const ScanFormat& format,
                            const Pose& world_from_deskewed, int frame, FileNotes notes) {
    const std::optional<Pose> dataset_from_points = compute_output_frame_pose(format, world_from_deskewed);
    Points ends = place_points(scan, format.config, dataset_from_points, PointsOf::rays);
    PlacedScan placed{.scan = scan,
                      .format = format,
                      .frame = frame,
                      .origin = scan.image.origin,
                      .direction = scan.image.direction,
                      .end_m = std::move(ends.position_m),
                      .channels = scan.channels,
                      .notes = std::move(notes),
                      .dataset_from_points = dataset_from_points};
    if (!dataset_from_points) return placed;
    for (std::size_t k = 0; k < placed.channels.size(); ++k)
        placed.channels[k].values = std::move(ends.channels[k].values);
    FiringPoses target(scan, inverse(*dataset_from_points));
    for (std::size_t i = 0; i < placed.origin.size(); ++i) {
        const Pose& target_from_firing = target.at(i);
        placed.origin[i] = glm::vec3(target_from_firing * glm::dvec3(placed.origin[i]));
        placed.direction[i] =
            glm::vec3(glm::normalize(target_from_firing.rotation * glm::dvec3(placed.direction[i])));
    }
    return placed;
}

Points make_output_points(const PlacedScan& placed) {
    return place_points(placed.scan, placed.format.config, placed.dataset_from_points);
}

std::size_t count_points(const RenderedScan& scan, const Config& config) {
    const std::vector<float>& range_m = select_point_ranges(scan, config);
    std::size_t n = 0;
    for (std::size_t i = 0; i < range_m.size(); ++i) n += is_returned(scan.image.drop_prob[i], range_m[i]);
    return n;
}

}  // namespace relidar::scan_files
