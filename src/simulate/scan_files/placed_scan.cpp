// SPDX-License-Identifier: Apache-2.0
#include "placed_scan.hpp"

#include <utility>

namespace relidar::scan_files {
namespace {

/// Whether a ray gives a point at this range.
bool is_point(const RenderedScan& scan, std::size_t ray, float range_m) {
    return returned(scan.image.drop_prob[ray], range_m);
}

/// @param number  of the return, from 1: of the second one what is known of the ray
void add_point(PointCloud& cloud, const PlacedScan& placed, std::size_t ray, float range_m, float intensity,
               int number) {
    const RenderedScan& scan = placed.scan;
    cloud.position_m.push_back(placed.origin[ray] + range_m * placed.direction[ray]);
    cloud.intensity.push_back(intensity);
    cloud.ring->push_back(scan.ring[ray]);
    cloud.time->push_back(scan.time_offset_s[ray]);
    cloud.instance->push_back(number == 1 ? scan.instance[ray] : -1);
    for (std::size_t k = 0; k < cloud.channels.size(); ++k)
        append_return(cloud.channels[k], placed.channels[k], ray, number);
    if (cloud.return_number) cloud.return_number->push_back(static_cast<std::uint8_t>(number));
}

}  // namespace

PlacedScan place(const RenderedScan& scan, const ScanFormat& format, const Pose& world_from_deskewed,
                 int frame, FileNotes notes) {
    check_channels(scan.channels, scan.image.range_m.size(), "a scan");
    PlacedScan placed{scan,          format,          frame, scan.image.origin, scan.image.direction,
                      scan.channels, std::move(notes)};
    const bool world = format.frame == PointFrame::world;
    if (!world && !format.deskew) return placed;
    FiringPoses target(scan, world ? Pose{} : inverse(world_from_deskewed));
    std::vector<std::vector<glm::vec3>*> turning;
    for (auto& [info, values, second] : placed.channels)
        if (auto* vectors = std::get_if<std::vector<glm::vec3>>(&values); vectors && info.turns)
            turning.push_back(vectors);
    for (std::size_t i = 0; i < placed.origin.size(); ++i) {
        const Pose& target_from_firing = target.at(i);
        placed.origin[i] = glm::vec3(target_from_firing * glm::dvec3(placed.origin[i]));
        placed.direction[i] =
            glm::vec3(glm::normalize(target_from_firing.rotation * glm::dvec3(placed.direction[i])));
        for (std::vector<glm::vec3>* vectors : turning)
            (*vectors)[i] = glm::vec3(target_from_firing.rotation * glm::dvec3((*vectors)[i]));
    }
    return placed;
}

PointCloud cloud_of(const PlacedScan& placed) {
    const RenderedScan& scan = placed.scan;
    const std::vector<float>& range_m = point_ranges(scan, placed.format.config);
    PointCloud cloud;
    cloud.ring.emplace(), cloud.time.emplace(), cloud.instance.emplace();
    cloud.channels = emptied(placed.channels);
    cloud.notes = placed.notes;
    if (!scan.second_returns.empty()) cloud.return_number.emplace();
    if (placed.format.frame == PointFrame::sensor) cloud.world_from_points = scan.world_from_sensor;
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        if (!is_point(scan, i, range_m[i])) continue;
        add_point(cloud, placed, i, range_m[i], scan.image.intensity[i], 1);
        if (!scan.second_returns.empty() && scan.second_returns[0].range_m[i] > 0.0f)
            add_point(cloud, placed, i, scan.second_returns[0].range_m[i],
                      scan.second_returns[0].intensity[i], 2);
    }
    return cloud;
}

std::size_t count_points(const RenderedScan& scan, const Config& config) {
    const std::vector<float>& range_m = point_ranges(scan, config);
    std::size_t n = 0;
    for (std::size_t i = 0; i < range_m.size(); ++i) n += is_point(scan, i, range_m[i]);
    return n;
}

}  // namespace relidar::scan_files
