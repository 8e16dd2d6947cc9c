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
    std::vector<ThinPoint> points;
    for (const std::size_t ray : thin_rays(sequence, position, options, cell_m)) points.push_back(point_of(sequence, position, ray));
    return points;
}

}  // namespace

std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options, double cell_m) {
    const Frame& frame = sequence.frames[std::size_t(position)];
    const Scan& scan = frame.scan;
    std::unordered_set<std::uint64_t> taken;
    std::vector<std::size_t> rays;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const std::uint64_t cell = cell_key(scan.point(ray), cell_m);
        if (taken.contains(cell) || is_mover(options, world_return(sequence, frame, ray))) continue;
        taken.insert(cell);
        rays.push_back(ray);
    }
    return rays;
}

ThinPoint point_of(const Sequence& sequence, int position, std::size_t ray) {
    const Frame& frame = sequence.frames[std::size_t(position)];
    const RayTable& rays = frame.scan.rays;
    const TrackPlace at = sequence.world_from_vehicle.place(world_return(sequence, frame, ray).time_s);
    return {rays.origin[ray] + surface_return(sequence, frame, ray).range_m * rays.direction[ray], static_cast<float>(at.s),
            static_cast<std::uint32_t>(at.left), static_cast<std::uint32_t>(position)};
}

PlacedPoint place(const PoseTrack& track, const ThinPoint& point) {
    const Pose pose =
        track.pose.size() == 1 ? track.pose.front() : interpolate(track.pose[point.left], track.pose[point.left + 1], double(point.s));
    return {pose * glm::dvec3(point.point_m), pose.translation};
}

double share_of(const ThinPoint& point, std::size_t pose) {
    return point.left == pose ? 1.0 - double(point.s) : point.left + 1 == pose ? double(point.s) : 0.0;
}

std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const std::vector<int>& positions, const RegisterOptions& options,
                                               double cell_m) {
    std::vector<std::vector<ThinPoint>> scans(positions.size());
    run_parallel(static_cast<int>(positions.size()),
                 [&](int i) { scans[std::size_t(i)] = thin(sequence, positions[std::size_t(i)], options, cell_m); });
    return scans;
}

}  // namespace relidar
