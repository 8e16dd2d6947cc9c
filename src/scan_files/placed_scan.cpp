// SPDX-License-Identifier: Apache-2.0
#include "placed_scan.hpp"

#include <utility>

namespace relidar::scan_files {
namespace {

/// Whether a ray gives a point at this range.
bool is_point(const RenderedScan& scan, std::size_t ray, float range_m) {
    return returned(scan.image.drop_prob[ray], range_m);
}

/// @param number  of the return, from 1; normal, instance and spread are known of the first
void add_point(PointCloud& cloud, const PlacedScan& placed, std::size_t ray, float range_m, float intensity, int number) {
    const RenderedScan& scan = placed.scan;
    cloud.position_m.push_back(placed.origin[ray] + range_m * placed.direction[ray]);
    cloud.intensity.push_back(intensity);
    cloud.ring->push_back(scan.channel[ray]);
    cloud.time->push_back(scan.time_offset_s[ray]);
    cloud.instance->push_back(number == 1 ? scan.instance[ray] : -1);
    if (cloud.normal) cloud.normal->push_back(number == 1 ? placed.normal[ray] : glm::vec3(0.0f));
    if (cloud.spread) cloud.spread->push_back(number == 1 ? (*placed.spread_m)[ray] : 0.0f);
    if (cloud.seen) cloud.seen->push_back(scan.seen[ray]);
    if (cloud.return_number) cloud.return_number->push_back(static_cast<std::uint8_t>(number));
}

}  // namespace

PlacedScan place(const RenderedScan& scan, const ScanFormat& format, const Pose& world_from_deskewed, int frame, FileNotes notes) {
    PlacedScan placed{scan, format, frame, scan.image.origin, scan.image.direction, scan.normal, {}, std::move(notes)};
    if (format.config.render.spread) placed.spread_m = range_spread(scan);
    const bool world = format.frame == PointFrame::world;
    if (!world && !format.deskew) return placed;
    const Pose target_from_world = world ? Pose{} : inverse(world_from_deskewed);
    for (std::size_t i = 0; i < placed.origin.size(); ++i) {
        const Pose target_from_firing = target_from_world * placed.scan.world_from_firing(i);
        placed.origin[i] = glm::vec3(target_from_firing * glm::dvec3(placed.origin[i]));
        placed.direction[i] = glm::vec3(glm::normalize(target_from_firing.rotation * glm::dvec3(placed.direction[i])));
        if (!placed.normal.empty()) placed.normal[i] = glm::vec3(target_from_firing.rotation * glm::dvec3(placed.normal[i]));
    }
    return placed;
}

PointCloud cloud_of(const PlacedScan& placed) {
    const RenderedScan& scan = placed.scan;
    const std::vector<float>& range_m = point_ranges(scan, placed.format.config);
    PointCloud cloud;
    cloud.ring.emplace(), cloud.time.emplace(), cloud.instance.emplace();
    if (!placed.normal.empty()) cloud.normal.emplace();
    if (placed.spread_m) cloud.spread.emplace();
    if (!scan.seen.empty()) cloud.seen.emplace();
    cloud.notes = placed.notes;
    if (!scan.further.empty()) cloud.return_number.emplace();
    if (placed.format.frame == PointFrame::sensor) cloud.world_from_points = scan.world_from_sensor;
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        if (!is_point(scan, i, range_m[i])) continue;
        add_point(cloud, placed, i, range_m[i], scan.image.intensity[i], 1);
        if (!scan.further.empty() && scan.further[0].range_m[i] > 0.0f)
            add_point(cloud, placed, i, scan.further[0].range_m[i], scan.further[0].intensity[i], 2);
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
