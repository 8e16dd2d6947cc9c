// SPDX-License-Identifier: Apache-2.0
#include "placed_scan.hpp"

#include <utility>

#include <relidar/simulate/place_points.hpp>

namespace relidar::scan_files {
std::optional<Pose> compute_world_from_output_frame(const ScanOutputOptions& format,
                                                    const Pose& world_from_deskewed) {
    if (format.frame == PointCoordinateFrame::world) return Pose{};
    return format.deskew ? std::optional(world_from_deskewed) : std::nullopt;
}

ScanInOutputFrame transform_scan_to_output_frame(const RenderedScan& scan, const ScanOutputOptions& format,
                                                 const Pose& world_from_deskewed, int frame_number,
                                                 FileMetadata file_notes) {
    const std::optional<Pose> dataset_from_points =
        compute_world_from_output_frame(format, world_from_deskewed);
    LidarPoints ends = convert_scan_to_points(scan, format.config, dataset_from_points, PointSelection::rays);
    ScanInOutputFrame placed{.scan = scan,
                             .format = format,
                             .frame = frame_number,
                             .origin = scan.image.origin,
                             .direction = scan.image.direction,
                             .end_m = std::move(ends.position_m),
                             .channels = scan.channels,
                             .notes = std::move(file_notes),
                             .dataset_from_points = dataset_from_points};
    if (!dataset_from_points) return placed;
    for (std::size_t k = 0; k < placed.channels.size(); ++k)
        placed.channels[k].values = std::move(ends.channels[k].values);
    FiringPoseInterpolator target(scan, inverse(*dataset_from_points));
    for (std::size_t i = 0; i < placed.origin.size(); ++i) {
        const Pose& target_from_firing = target.compute_firing_pose(i);
        placed.origin[i] = glm::vec3(target_from_firing * glm::dvec3(placed.origin[i]));
        placed.direction[i] =
            glm::vec3(glm::normalize(target_from_firing.rotation * glm::dvec3(placed.direction[i])));
    }
    return placed;
}

LidarPoints make_points_of_returns(const ScanInOutputFrame& output_scan) {
    return convert_scan_to_points(output_scan.scan, output_scan.format.config,
                                  output_scan.dataset_from_points);
}

std::size_t count_rays_with_returns(const RenderedScan& scan, const Config& point_range_config) {
    const std::vector<float>& range_m = select_point_ranges(scan, point_range_config);
    std::size_t n = 0;
    for (std::size_t i = 0; i < range_m.size(); ++i)
        n += is_ray_returned(scan.image.drop_prob[i], range_m[i]);
    return n;
}

}  // namespace relidar::scan_files
