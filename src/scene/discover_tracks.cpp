// SPDX-License-Identifier: Apache-2.0
// Tracks of what moves without a label: groups of returns that other frames see through, linked from frame to frame, registered onto each
// other, and boxed.
#include <relidar/scene.hpp>

#include <algorithm>
#include <cmath>
#include <tuple>

#include <fmt/format.h>
#include <nanoflann.hpp>

#include "core/parallel.hpp"
#include "scene/mover_clusters.hpp"

namespace relidar {
namespace {

constexpr double kMaxGap_s = 0.35;          // a track ends where nothing continues it so long
constexpr double kFirstSpeed_mps = 15.0;    // of something seen once
constexpr double kAcceleration_m = 0.4, kAcceleration_mps = 4.0;   // what a prediction may be off, at once and a second
constexpr std::size_t kMinObservations = 6;
constexpr double kMinPath_m = 0.6;
constexpr double kMinStraightness = 0.5;    // of the path: noise walks to and fro
constexpr double kSmooth_s = 0.45;          // a track is a parabola over so long to either side
constexpr int kRounds = 4;                  // of registration
constexpr std::size_t kModelObservations = 8;   // to either side that an observation is registered onto
constexpr double kMargin_m = 0.1;           // of the box around its points
constexpr double kGround_m = 0.15;          // the lowest part of a box counts as ground (actors.cpp)

struct Observation {
    double frame_time_s;
    MoverCluster cluster;
};

struct Track {
    std::vector<Observation> seen;
    const MoverCluster& last() const { return seen.back().cluster; }
    glm::dvec3 velocity() const {
        if (seen.size() < 2) return glm::dvec3(0.0);
        const MoverCluster& from = seen[seen.size() - std::min<std::size_t>(seen.size(), 4)].cluster;
        return (last().centre_m - from.centre_m) / std::max(last().time_s - from.time_s, 1e-3);
    }
};

/// How far a cluster is from where a track would be; beyond 1 it is something else.
double mismatch(const Track& track, const MoverCluster& cluster) {
    const double dt = cluster.time_s - track.last().time_s;
    if (!(dt > 0.0 && dt < kMaxGap_s)) return 2.0;
    const double ratio = double(cluster.points_m.size()) / double(track.last().points_m.size());
    if (ratio > 4.0 || ratio < 0.25) return 2.0;
    const double gate = track.seen.size() < 2 ? kAcceleration_m + kFirstSpeed_mps * dt : kAcceleration_m + kAcceleration_mps * dt;
    return glm::length(glm::dvec2(cluster.centre_m - track.last().centre_m - dt * track.velocity())) / gate;
}

/// Links clusters of ascending frames, the best fits of a frame first.
std::vector<Track> link(const std::vector<std::vector<MoverCluster>>& clusters, const std::vector<double>& frame_times_s) {
    struct Fit {
        double mismatch;
        std::size_t track, cluster;
    };
    std::vector<Track> tracks;
    for (std::size_t f = 0; f < clusters.size(); ++f) {
        std::vector<Fit> fits;
        for (std::size_t t = 0; t < tracks.size(); ++t)
            for (std::size_t c = 0; c < clusters[f].size(); ++c)
                if (const double m = mismatch(tracks[t], clusters[f][c]); m < 1.0) fits.push_back({m, t, c});
        std::sort(fits.begin(), fits.end(), [](const Fit& a, const Fit& b) { return std::tie(a.mismatch, a.track, a.cluster) < std::tie(b.mismatch, b.track, b.cluster); });
        std::vector<char> track_taken(tracks.size(), 0), cluster_taken(clusters[f].size(), 0);
        for (const Fit& fit : fits) {
            if (track_taken[fit.track] || cluster_taken[fit.cluster]) continue;
            track_taken[fit.track] = cluster_taken[fit.cluster] = 1;
            tracks[fit.track].seen.push_back({frame_times_s[f], clusters[f][fit.cluster]});
        }
        for (std::size_t c = 0; c < clusters[f].size(); ++c)
            if (!cluster_taken[c]) tracks.push_back({{{frame_times_s[f], clusters[f][c]}}});
    }
    return tracks;
}

/// Position and velocity of a curve through noisy values: a parabola over the neighbourhood of t_s, or a straight line where that has few.
struct Motion {
    glm::dvec3 position_m, velocity_mps;
};
Motion smoothed(const std::vector<double>& time_s, const std::vector<glm::dvec3>& position_m, double t_s) {
    const double reach = kSmooth_s;
    double moment[5] = {};
    glm::dvec3 sum[3] = {glm::dvec3(0.0), glm::dvec3(0.0), glm::dvec3(0.0)};
    int n = 0;
    for (std::size_t i = 0; i < time_s.size(); ++i) {
        const double x = (time_s[i] - t_s) / reach;
        if (std::abs(x) > 1.5) continue;
        const double weight = std::exp(-2.0 * x * x);
        ++n;
        for (int k = 0; k < 5; ++k) moment[k] += weight * std::pow(x, k);
        for (int k = 0; k < 3; ++k) sum[k] += weight * std::pow(x, k) * position_m[i];
    }
    if (n < 5) moment[4] += 1e6;   // no curvature
    const glm::dmat3 normal(moment[0], moment[1], moment[2], moment[1], moment[2], moment[3], moment[2], moment[3], moment[4]);
    const glm::dmat3 inverse_normal = glm::inverse(normal + glm::dmat3(1e-9));
    Motion result;
    for (int axis = 0; axis < 3; ++axis) {
        const glm::dvec3 c = inverse_normal * glm::dvec3(sum[0][axis], sum[1][axis], sum[2][axis]);
        result.position_m[axis] = c[0];
        result.velocity_mps[axis] = c[1] / reach;
    }
    return result;
}

std::vector<double> times_of(const Track& track) {
    std::vector<double> times;
    for (const Observation& o : track.seen) times.push_back(o.cluster.time_s);
    return times;
}

bool moves(const Track& track) {
    if (track.seen.size() < kMinObservations) return false;
    std::vector<glm::dvec3> centres;
    for (const Observation& o : track.seen) centres.push_back(o.cluster.centre_m * glm::dvec3(1.0, 1.0, 0.0));
    const std::vector<double> times = times_of(track);
    std::vector<glm::dvec3> path;
    for (const double t : times) path.push_back(smoothed(times, centres, t).position_m);
    double length = 0.0;
    for (std::size_t i = 1; i < path.size(); ++i) length += glm::distance(path[i - 1], path[i]);
    const double net = glm::distance(path.front(), path.back());
    return net > kMinPath_m && net > kMinStraightness * length;
}

/// A frame of the ground: position and heading.
struct Placement {
    glm::dvec3 position_m{0.0};
    double yaw = 0.0;
    glm::dvec3 to_local(const glm::dvec3& world) const {
        const glm::dvec3 d = world - position_m;
        return {std::cos(yaw) * d.x + std::sin(yaw) * d.y, -std::sin(yaw) * d.x + std::cos(yaw) * d.y, d.z};
    }
    glm::dvec3 to_world(const glm::dvec3& local) const {
        return position_m + glm::dvec3(std::cos(yaw) * local.x - std::sin(yaw) * local.y, std::sin(yaw) * local.x + std::cos(yaw) * local.y, local.z);
    }
};

/// Headings along the motion; of something nearly at rest, that of its whole path.
std::vector<Placement> smooth_placements(const std::vector<double>& times, const std::vector<Placement>& placed, const std::vector<double>& at_s) {
    std::vector<glm::dvec3> positions, turns;
    double unwrapped = placed.front().yaw;
    for (const Placement& p : placed) {
        positions.push_back(p.position_m);
        unwrapped += std::remainder(p.yaw - unwrapped, 2.0 * kPi);
        turns.push_back({unwrapped, 0.0, 0.0});
    }
    std::vector<Placement> result;
    for (const double t : at_s) result.push_back({smoothed(times, positions, t).position_m, smoothed(times, turns, t).position_m.x});
    return result;
}

std::vector<Placement> start_placements(const Track& track, const std::vector<double>& times) {
    std::vector<glm::dvec3> centres;
    for (const Observation& o : track.seen) centres.push_back(o.cluster.centre_m);
    const glm::dvec3 whole = centres.back() - centres.front();
    std::vector<Placement> placed;
    for (const double t : times) {
        const Motion motion = smoothed(times, centres, t);
        const bool slow = glm::length(glm::dvec2(motion.velocity_mps)) < 0.5;
        const glm::dvec3 along = slow ? whole : motion.velocity_mps;
        placed.push_back({motion.position_m, std::atan2(along.y, along.x)});
    }
    return placed;
}

struct Cloud {
    std::vector<glm::dvec3> points;
    std::size_t kdtree_get_point_count() const { return points.size(); }
    double kdtree_get_pt(std::size_t i, std::size_t axis) const { return points[i][static_cast<int>(axis)]; }
    template <class Box>
    bool kdtree_get_bbox(Box&) const { return false; }
};
using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<double, Cloud>, Cloud, 3, std::size_t>;

/// Every n-th point, so that there are at most so many.
template <class Visit>
void some_points(const MoverCluster& cluster, std::size_t most, const Visit& visit) {
    const std::size_t stride = cluster.points_m.size() / most + 1;
    for (std::size_t i = 0; i < cluster.points_m.size(); i += stride) visit(cluster.points_m[i]);
}

/// Moves one observation onto its neighbours in the track: closest points, a turn and a shift of the ground plane and a lift.
Placement registered(const Track& track, const std::vector<Placement>& placed, std::size_t k, double reach_m) {
    Cloud model;
    for (std::size_t j = k - std::min(k, kModelObservations); j < std::min(track.seen.size(), k + kModelObservations + 1); ++j)
        if (j != k) some_points(track.seen[j].cluster, 300, [&](const glm::dvec3& p) { model.points.push_back(placed[j].to_local(p)); });
    const Tree tree(3, model);
    Placement at = placed[k];
    for (int step = 0; step < 6; ++step) {
        std::vector<std::pair<glm::dvec3, glm::dvec3>> pairs;   // local, model
        some_points(track.seen[k].cluster, 300, [&](const glm::dvec3& p) {
            const glm::dvec3 local = at.to_local(p);
            std::size_t nearest = 0;
            double distance2 = 0.0;
            tree.knnSearch(&local[0], 1, &nearest, &distance2);
            if (distance2 < reach_m * reach_m) pairs.emplace_back(local, model.points[nearest]);
        });
        if (pairs.size() < 10) return placed[k];
        glm::dvec3 from(0.0), to(0.0);
        for (const auto& [a, b] : pairs) from += a, to += b;
        from /= double(pairs.size()), to /= double(pairs.size());
        double s = 0.0, c = 0.0;
        for (const auto& [a, b] : pairs) {
            const glm::dvec2 x(a - from), y(b - to);
            c += glm::dot(x, y);
            s += x.x * y.y - x.y * y.x;
        }
        const double turn = std::clamp(std::atan2(s, c), -0.05, 0.05);
        // local' = R(turn) (local - from) + to, so the frame turns the other way about the same points.
        const glm::dvec3 pivot = at.to_world(from);
        at.yaw -= turn;
        at.position_m = pivot - (at.to_world(to) - at.position_m);
    }
    return at;
}

/// The box of a track's points in its own frame, without the few that are farthest out.
BoxTrack boxed(const Track& track, const std::vector<Placement>& placed, const std::vector<Placement>& at_frames) {
    std::vector<double> along[3];
    for (std::size_t k = 0; k < track.seen.size(); ++k)
        for (const glm::dvec3& p : track.seen[k].cluster.points_m) {
            const glm::dvec3 local = placed[k].to_local(p);
            for (int axis = 0; axis < 3; ++axis) along[axis].push_back(local[axis]);
        }
    glm::dvec3 low, high;
    for (int axis = 0; axis < 3; ++axis) {
        std::sort(along[axis].begin(), along[axis].end());
        const std::size_t cut = along[axis].size() / 100;
        low[axis] = along[axis][cut] - kMargin_m;
        high[axis] = along[axis][along[axis].size() - 1 - cut] + kMargin_m;
    }
    low.z -= kGround_m;
    BoxTrack box;
    box.category = kDiscoveredCategory;
    box.size_m = high - low;
    for (std::size_t k = 0; k < at_frames.size(); ++k) {
        const double half = 0.5 * at_frames[k].yaw;
        box.world_from_box.time_s.push_back(track.seen[k].frame_time_s);
        box.world_from_box.pose.push_back({glm::dquat(std::cos(half), 0.0, 0.0, std::sin(half)), at_frames[k].to_world(0.5 * (low + high))});
    }
    return box;
}

BoxTrack box_of(const Track& track) {
    const std::vector<double> times = times_of(track);
    std::vector<double> frame_times;
    for (const Observation& o : track.seen) frame_times.push_back(o.frame_time_s);
    std::vector<Placement> placed = start_placements(track, times);
    for (int round = 0; round < kRounds; ++round) {
        std::vector<Placement> next;
        for (std::size_t k = 0; k < placed.size(); ++k) next.push_back(registered(track, placed, k, round == 0 ? 0.8 : 0.4));
        placed = smooth_placements(times, next, times);
    }
    return boxed(track, placed, smooth_placements(times, placed, frame_times));
}

}  // namespace

std::vector<BoxTrack> discover_tracks(const Sequence& sequence, const std::vector<int>& train_positions, const InitialiseOptions& options) {
    std::vector<double> times;
    for (const int position : train_positions) times.push_back(sequence.frames[std::size_t(position)].time_s);
    std::vector<Track> tracks = link(find_mover_clusters(sequence, train_positions, options), times);
    std::erase_if(tracks, [](const Track& track) { return !moves(track); });
    std::vector<BoxTrack> boxes(tracks.size());
    run_parallel(static_cast<int>(tracks.size()), [&](int i) { boxes[std::size_t(i)] = box_of(tracks[std::size_t(i)]); });
    for (std::size_t i = 0; i < boxes.size(); ++i) boxes[i].id = fmt::format("mover-{}", i);
    return boxes;
}

}  // namespace relidar
