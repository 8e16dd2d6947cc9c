// SPDX-License-Identifier: Apache-2.0
#include "registration/thin_scans.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_set>

#include "core/cell_key.hpp"
#include "core/parallel.hpp"

namespace relidar {
namespace {

bool is_mover(const RegisterOptions& options, const WorldReturn& w) {
    return std::any_of(options.movers.begin(), options.movers.end(), [&](const BoxTrack& box) {
        return box.present(w.time_s) && box.holds(w.point_m, w.time_s, options.mover_margin_m);
    });
}

std::vector<ThinPoint> thin(const Sequence& sequence, int position, const RegisterOptions& options, double cell_m) {
    const Frame& frame = sequence.frames[std::size_t(position)];
    const Scan& scan = frame.scan;
    std::unordered_set<std::uint64_t> taken;
    std::vector<ThinPoint> points;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const glm::vec3 point = scan.point(ray);
        if (taken.contains(cell_key(point, cell_m))) continue;
        const WorldReturn w = world_return(sequence, frame, ray);
        if (is_mover(options, w)) continue;
        taken.insert(cell_key(point, cell_m));
        const TrackPlace at = sequence.world_from_vehicle.place(w.time_s);
        points.push_back({point, static_cast<float>(at.s), static_cast<std::uint32_t>(at.left), static_cast<std::uint32_t>(position)});
    }
    return points;
}

}  // namespace

PlacedPoint place(const PoseTrack& track, const ThinPoint& point) {
    const Pose pose =
        track.pose.size() == 1 ? track.pose.front() : interpolate(track.pose[point.left], track.pose[point.left + 1], double(point.s));
    return {pose * glm::dvec3(point.point_m), pose.translation};
}

std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const std::vector<int>& positions, const RegisterOptions& options,
                                               double cell_m) {
    std::vector<std::vector<ThinPoint>> scans(positions.size());
    run_parallel(static_cast<int>(positions.size()),
                 [&](int i) { scans[std::size_t(i)] = thin(sequence, positions[std::size_t(i)], options, cell_m); });
    return scans;
}

}  // namespace relidar
