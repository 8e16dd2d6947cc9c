// SPDX-License-Identifier: Apache-2.0
// Calls a function for each pair of corresponding per-ray arrays of two scans. All code
// that joins, merges, bins or copies scans uses these functions. Private to simulate.
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Returns a scan with these rays and without values of the rays.
/// @param where scan of the same sweep with times, poses and channel names
inline RenderedScan empty_scan(const RayTable& rays, const RenderedScan& where = {}) {
    RenderedScan scan;
    scan.image.rows = rays.rows;
    scan.image.columns = rays.columns;
    scan.image.origin = to_vector(rays.origin);
    scan.image.direction = to_vector(rays.direction);
    scan.time_offset_s = to_vector(rays.time_offset_s);
    scan.ring = to_vector(rays.channel);
    scan.world_from_sensor = where.world_from_sensor;
    scan.track = where.track;
    scan.time_s = where.time_s;
    scan.trace_ms = where.trace_ms;
    scan.unseen_share = where.unseen_share;
    scan.actor_views = where.actor_views;
    scan.channels = copy_layout(where.channels);
    return scan;
}

/// Returns the optional channel with this name, or null if the scan does not have it.
template <class Scan>
auto* find_channel(Scan& scan, const std::string& name) {
    const auto match =
        std::ranges::find_if(scan.channels, [&](const ScanChannel& one) { return one.info.name == name; });
    return match == scan.channels.end() ? nullptr : &*match;
}

/// Calls visit(ChannelInfo, source values, target values) for the channels of every scan,
/// except time and ring.
template <class Visit>
void for_basic_channels(const RenderedScan& source, RenderedScan& target, Visit&& visit) {
    const BasicChannels& basic = basic_channels();
    visit(basic.range, source.image.range_m, target.image.range_m);
    visit(basic.median_range, source.median_range_m, target.median_range_m);
    visit(basic.mean_range, source.mean_range_m, target.mean_range_m);
    visit(basic.intensity, source.image.intensity, target.image.intensity);
    visit(basic.drop_prob, source.image.drop_prob, target.image.drop_prob);
    visit(basic.weight, source.weight, target.weight);
    visit(basic.instance, source.instance, target.instance);
}

/// Also visits the optional channels.
/// @param target must have the channels of `source` in the same order
template <class Visit>
void for_all_channels(const RenderedScan& source, RenderedScan& target, Visit&& visit) {
    for_basic_channels(source, target, visit);
    for (std::size_t k = 0; k < target.channels.size(); ++k) {
        const auto both = [&](auto& values) {
            visit(target.channels[k].info,
                  std::get<std::decay_t<decltype(values)>>(source.channels[k].values), values);
        };
        std::visit(both, target.channels[k].values);
    }
}

}  // namespace relidar
