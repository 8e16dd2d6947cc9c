// SPDX-License-Identifier: Apache-2.0
#include <relidar/render.hpp>

#include <algorithm>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {
namespace {

template <class T>
void append(std::vector<T>& to, const std::vector<T>& from) {
    to.insert(to.end(), from.begin(), from.end());
}

/// Rays in the rig's frame when each was fired, by where sensor and rig were then: between poses a sensor moves along a chord and so does
/// the rig, which is not quite the same. @param first_channel  number of the scan's channel 0 in the merged one
void append_rays(RenderedScan& merged, const RenderedScan& scan, std::size_t first_channel) {
    for (std::size_t i = 0; i < scan.image.origin.size(); ++i) {
        merged.time_offset_s.push_back(scan.time_offset_s[i]);
        merged.channel.push_back(static_cast<std::uint16_t>(first_channel + scan.channel[i]));
        const Pose rig_from_firing = inverse(merged.world_from_firing(merged.time_offset_s.size() - 1)) * scan.world_from_firing(i);
        merged.image.origin.emplace_back(rig_from_firing * glm::dvec3(scan.image.origin[i]));
        merged.image.direction.emplace_back(glm::normalize(rig_from_firing.rotation * glm::dvec3(scan.image.direction[i])));
        if (!scan.normal.empty()) merged.normal.emplace_back(rig_from_firing.rotation * glm::dvec3(scan.normal[i]));
    }
}

}  // namespace

RenderedScan merge_scans(const std::vector<RenderedScan>& scans, const std::vector<Pose>& rig_from_sensor) {
    if (scans.empty() || scans.size() != rig_from_sensor.size())
        throw UsageError(fmt::format("merging scans: found {} scans and {} mountings, expected as many of both", scans.size(),
                                     rig_from_sensor.size()));
    RenderedScan merged;
    const Pose sensor_from_rig = inverse(rig_from_sensor[0]);
    merged.world_from_sensor = scans[0].world_from_sensor * sensor_from_rig;
    merged.track = moved_track(scans[0].track, sensor_from_rig);
    merged.time_s = scans[0].time_s;
    std::size_t channels = 0;
    double unseen_rays = 0.0;
    for (const RenderedScan& scan : scans) {
        append_rays(merged, scan, channels);
        if (!scan.channel.empty()) channels += std::size_t(*std::ranges::max_element(scan.channel)) + 1;
        if (channels > 65536) throw UsageError(fmt::format("merging scans: found {} channels, expected at most 65536", channels));
        append(merged.image.range_m, scan.image.range_m);
        append(merged.image.intensity, scan.image.intensity);
        append(merged.image.drop_prob, scan.image.drop_prob);
        append(merged.median_range_m, scan.median_range_m);
        append(merged.mean_range_m, scan.mean_range_m);
        append(merged.weight, scan.weight);
        append(merged.instance, scan.instance);
        append(merged.seen, scan.seen);
        if (scan.unseen_share) {
            unseen_rays += *scan.unseen_share * double(scan.instance.size());
            merged.unseen_share = unseen_rays / double(merged.instance.size());
        }
        merged.further.resize(std::max(merged.further.size(), scan.further.size()));
        for (std::size_t k = 0; k < scan.further.size(); ++k) {
            append(merged.further[k].range_m, scan.further[k].range_m);
            append(merged.further[k].intensity, scan.further[k].intensity);
        }
        merged.trace_ms += scan.trace_ms;
    }
    merged.image.rows = 1;
    merged.image.columns = static_cast<int>(merged.image.range_m.size());
    return merged;
}

}  // namespace relidar
