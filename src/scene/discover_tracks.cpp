// SPDX-License-Identifier: Apache-2.0
// Tracks of what moves without a label: groups of returns that other frames see through, linked from frame to frame, placed by their near
// ends along their motion, and boxed.
#include <relidar/scene.hpp>

#include <algorithm>
#include <cmath>
#include <optional>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "core/parallel.hpp"
#include "core/progress_blocks.hpp"
#include "scene/mover_clusters.hpp"
#include "scene/mover_evidence.hpp"

namespace relidar {
namespace {

constexpr double kMaxGap_s = 0.35;          // a track ends where nothing continues it so long
constexpr double kFirstSpeed_mps = 15.0;    // of something seen once
constexpr double kAcceleration_m = 0.7, kAcceleration_mps = 4.0;   // what a prediction may be off, at once and a second
constexpr double kMaxRatio = 8.0;            // of the numbers of returns of one thing in successive frames
constexpr std::size_t kMinObservations = 6;
constexpr double kMinPath_m = 0.6;
constexpr double kMinStraightness = 0.5;    // of the path: noise walks to and fro
constexpr double kOwnVehicle_m = 4.0, kRides_m = 0.3;
constexpr double kSmooth_s = 0.45;          // a track is a parabola over so long to either side
constexpr double kTop_s = 1.0;              // the road rises little while this passes
constexpr double kMargin_m = 0.1;           // of the box around its points
constexpr double kFragment_m = 0.5, kVehicleFragment_m = 1.0;   // around a box, where another track may be a part of the same thing
constexpr double kProvenShare = 0.5;        // of the frames of a track, of whose returns others say that they moved
constexpr std::size_t kFewestPoints = 5;    // of a frame, once those that stayed are out
constexpr double kLongest_m = 20.0, kWidest_m = 3.2, kTallest_m = 4.5;
constexpr double kSpeedOver_s = 0.5, kSlowest_mps = 0.4, kFastest_mps = 50.0;
constexpr double kVehicle_m = 1.2;          // parts as large belong to a vehicle, not to people who walk together
constexpr double kBesides_m = 1.5;          // between parts of one vehicle
constexpr double kRigid_m = 0.5;            // standard deviation of where a part is seen of the whole: its visible side changes
constexpr double kGround_m = 0.15;          // the lowest part of a box counts as ground (actors.cpp)

struct Observation {
    double frame_time_s;
    glm::dvec3 sensor_m;   ///< where the sensor was, world
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
    if (ratio > kMaxRatio || ratio < 1.0 / kMaxRatio) return 2.0;
    const double gate = track.seen.size() < 2 ? kAcceleration_m + kFirstSpeed_mps * dt : kAcceleration_m + kAcceleration_mps * dt;
    return glm::length(glm::dvec2(cluster.centre_m - track.last().centre_m - dt * track.velocity())) / gate;
}

/// Links clusters of ascending frames, the best fits of a frame first.
std::vector<Track> link(const std::vector<std::vector<MoverCluster>>& clusters, const std::vector<double>& frame_times_s,
                        const PoseTrack& world_from_vehicle) {
    struct Fit {
        double mismatch;
        std::size_t track, cluster;
    };
    std::vector<Track> tracks;
    std::vector<std::size_t> open;   // those that may go on
    for (std::size_t f = 0; f < clusters.size(); ++f) {
        std::vector<Fit> fits;
        std::erase_if(open, [&](std::size_t t) { return frame_times_s[f] - tracks[t].seen.back().frame_time_s > 2.0 * kMaxGap_s; });
        for (const std::size_t t : open)
            for (std::size_t c = 0; c < clusters[f].size(); ++c)
                if (const double m = mismatch(tracks[t], clusters[f][c]); m < 1.0) fits.push_back({m, t, c});
        std::sort(fits.begin(), fits.end(), [](const Fit& a, const Fit& b) {
            return std::tie(a.mismatch, a.track, a.cluster) < std::tie(b.mismatch, b.track, b.cluster);
        });
        const auto observation = [&](std::size_t c) {
            return Observation{frame_times_s[f], world_from_vehicle.at(clusters[f][c].time_s).translation, clusters[f][c]};
        };
        std::vector<char> track_taken(tracks.size(), 0), cluster_taken(clusters[f].size(), 0);
        for (const Fit& fit : fits) {
            if (track_taken[fit.track] || cluster_taken[fit.cluster]) continue;
            track_taken[fit.track] = cluster_taken[fit.cluster] = 1;
            tracks[fit.track].seen.push_back(observation(fit.cluster));
        }
        for (std::size_t c = 0; c < clusters[f].size(); ++c)
            if (!cluster_taken[c]) {
                open.push_back(tracks.size());
                tracks.push_back({{observation(c)}});
            }
    }
    return tracks;
}

/// Position and velocity of a curve through noisy values: a parabola over the neighbourhood of t_s, or a straight line where that has few
/// values or the curve is to be stiff.
struct Motion {
    glm::dvec3 position_m, velocity_mps;
};
Motion smoothed(const std::vector<double>& time_s, const std::vector<glm::dvec3>& position_m, double t_s, bool stiff = false) {
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
    if (stiff || n < 5) moment[4] += 1e6;   // no curvature
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

/// Whether it stays where it is as seen from the sensor, close by: a part of the vehicle that carries the sensor.
bool rides_along(const Track& track, const PoseTrack& world_from_vehicle) {
    std::vector<glm::dvec3> places;
    for (const Observation& o : track.seen) places.push_back(inverse(world_from_vehicle.at(o.cluster.time_s)) * o.cluster.centre_m);
    const auto is_near = [&](const glm::dvec3& p) { return glm::distance(p, places[places.size() / 2]) < kRides_m; };
    return glm::length(places[places.size() / 2]) < kOwnVehicle_m &&
           std::count_if(places.begin(), places.end(), is_near) > std::ptrdiff_t(places.size() * 3 / 4);
}

/// The longer side of what is seen of something from above.
double width_seen(const MoverCluster& cluster) {
    glm::dvec2 low(1e30), high(-1e30);
    for (const glm::dvec3& p : cluster.points_m) low = glm::min(low, glm::dvec2(p)), high = glm::max(high, glm::dvec2(p));
    return std::max(high.x - low.x, high.y - low.y);
}

double gap_between(const MoverCluster& a, const MoverCluster& b) {
    double nearest = 1e30;
    for (const glm::dvec3& p : a.points_m)
        for (const glm::dvec3& q : b.points_m) nearest = std::min(nearest, glm::distance(glm::dvec2(p), glm::dvec2(q)));
    return nearest;
}

/// Pairs of observations of two tracks in the same frames.
std::vector<std::pair<std::size_t, std::size_t>> in_common(const Track& a, const Track& b) {
    std::vector<std::pair<std::size_t, std::size_t>> pairs;
    for (std::size_t i = 0, j = 0; i < a.seen.size() && j < b.seen.size();) {
        if (a.seen[i].frame_time_s < b.seen[j].frame_time_s) ++i;
        else if (b.seen[j].frame_time_s < a.seen[i].frame_time_s) ++j;
        else pairs.push_back({i++, j++});
    }
    return pairs;
}

/// Whether two tracks are parts of one vehicle, as its tail and its cabin with a roof that no beam meets between them.
bool move_as_one(const Track& whole, const Track& part) {
    const auto common = in_common(whole, part);
    if (2 * common.size() < part.seen.size() || common.size() < 4) return false;
    const auto& [i, j] = common[common.size() / 2];
    if (std::min(width_seen(whole.seen[i].cluster), width_seen(part.seen[j].cluster)) < kVehicle_m ||
        gap_between(whole.seen[i].cluster, part.seen[j].cluster) > kBesides_m)
        return false;
    glm::dvec3 sum(0.0), squares(0.0);
    for (const auto& [a, b] : common) {
        const glm::dvec3 apart = part.seen[b].cluster.centre_m - whole.seen[a].cluster.centre_m;
        sum += apart, squares += apart * apart;
    }
    const double n = double(common.size());
    const glm::dvec3 variance = squares / n - sum / n * (sum / n);
    return variance.x + variance.y < kRigid_m * kRigid_m;
}

/// Gives the returns of parts to the track of which they are parts.
void join_parts(std::vector<Track>& tracks) {
    std::stable_sort(tracks.begin(), tracks.end(), [](const Track& a, const Track& b) { return a.seen.size() > b.seen.size(); });
    for (std::size_t a = 0; a < tracks.size(); ++a)
        for (std::size_t b = a + 1; b < tracks.size(); ++b) {
            if (!move_as_one(tracks[a], tracks[b])) continue;
            for (const auto& [i, j] : in_common(tracks[a], tracks[b])) tracks[a].seen[i].cluster.take_in(tracks[b].seen[j].cluster);
            tracks.erase(tracks.begin() + std::ptrdiff_t(b--));
        }
}

/// A frame of the ground: position and heading.
struct Placement {
    glm::dvec3 position_m{0.0};
    double yaw = 0.0;
    /// x along the heading, y to its left.
    glm::dvec3 to_local(const glm::dvec3& world) const {
        const glm::dvec3 d = world - position_m;
        return {std::cos(yaw) * d.x + std::sin(yaw) * d.y, -std::sin(yaw) * d.x + std::cos(yaw) * d.y, d.z};
    }
    glm::dvec3 to_world(const glm::dvec3& local) const {
        return position_m +
               glm::dvec3(std::cos(yaw) * local.x - std::sin(yaw) * local.y, std::sin(yaw) * local.x + std::cos(yaw) * local.y, local.z);
    }
};

/// The same motion without the noise of single frames, at any times.
std::vector<Placement> smooth_placements(const std::vector<double>& times, const std::vector<Placement>& placed,
                                         const std::vector<double>& at_s) {
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

/// What of an observation lies between two ends along an axis, without the few points that are farthest out.
struct Extent {
    double low, high;
};
Extent extent_along(const MoverCluster& cluster, const glm::dvec3& axis) {
    std::vector<double> values;
    for (const glm::dvec3& p : cluster.points_m) values.push_back(glm::dot(axis, p));
    std::sort(values.begin(), values.end());
    const std::size_t cut = values.size() / 200;
    return {values[cut], values[values.size() - 1 - cut]};
}

/// Centre along one axis: of what is seen of a thing its near end is sure, and its length is what it showed when it showed most.
std::vector<double> centres_along(const Track& track, const std::vector<glm::dvec3>& axes) {
    std::vector<Extent> extents;
    std::vector<double> lengths;
    for (std::size_t k = 0; k < axes.size(); ++k) {
        extents.push_back(extent_along(track.seen[k].cluster, axes[k]));
        lengths.push_back(extents.back().high - extents.back().low);
    }
    std::sort(lengths.begin(), lengths.end());
    const double half = 0.5 * lengths[lengths.size() * 9 / 10];
    std::vector<double> centres;
    for (std::size_t k = 0; k < axes.size(); ++k) {
        const auto [low, high] = extents[k];
        const double sensor = glm::dot(axes[k], track.seen[k].sensor_m);
        centres.push_back(sensor > high ? high - half : sensor < low ? low + half : 0.5 * (low + high));
    }
    return centres;
}

/// Heights of the top: of a thing far away the beams miss some, so an observation takes the highest of those within a second.
std::vector<double> tops(const Track& track, const std::vector<double>& times) {
    std::vector<double> own, result;
    for (const Observation& o : track.seen) own.push_back(extent_along(o.cluster, {0.0, 0.0, 1.0}).high);
    for (const double t : times) {
        double top = -1e30;
        for (std::size_t j = 0; j < times.size(); ++j)
            if (std::abs(times[j] - t) < kTop_s) top = std::max(top, own[j]);
        result.push_back(top);
    }
    return result;
}

/// Directions of motion, on the ground; of something nearly at rest, that of its whole path.
std::vector<double> headings(const std::vector<double>& times, const std::vector<glm::dvec3>& path) {
    const glm::dvec3 whole = path.back() - path.front();
    std::vector<double> result;
    for (const double t : times) {
        const glm::dvec3 velocity = smoothed(times, path, t, true).velocity_mps;
        const glm::dvec3 along = glm::length(glm::dvec2(velocity)) < 0.5 ? whole : velocity;
        result.push_back(std::atan2(along.y, along.x));
    }
    return result;
}

/// Centres of a box that is seen from one side, along its motion, at the height of its top.
std::vector<Placement> placements(const Track& track, const std::vector<double>& times) {
    std::vector<glm::dvec3> path;
    for (const Observation& o : track.seen) path.push_back(o.cluster.centre_m);
    std::vector<double> yaw;
    for (int round = 0; round < 2; ++round) {   // the first path is that of what was seen, which turns as other sides appear
        yaw = headings(times, path);
        std::vector<glm::dvec3> along, across;
        for (const double angle : yaw) {
            along.push_back({std::cos(angle), std::sin(angle), 0.0});
            across.push_back({-std::sin(angle), std::cos(angle), 0.0});
        }
        const std::vector<double> x = centres_along(track, along), y = centres_along(track, across), top = tops(track, times);
        for (std::size_t k = 0; k < path.size(); ++k) path[k] = x[k] * along[k] + y[k] * across[k] + glm::dvec3(0.0, 0.0, top[k]);
    }
    std::vector<Placement> placed;
    for (std::size_t k = 0; k < path.size(); ++k) placed.push_back({path[k], yaw[k]});
    return smooth_placements(times, placed, times);
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
        box.world_from_box.pose.push_back(
            {glm::dquat(std::cos(half), 0.0, 0.0, std::sin(half)), at_frames[k].to_world(0.5 * (low + high))});
    }
    return box;
}

BoxTrack box_of(const Track& track) {
    const std::vector<double> times = times_of(track);
    std::vector<double> frame_times;
    for (const Observation& o : track.seen) frame_times.push_back(o.frame_time_s);
    const std::vector<Placement> placed = placements(track, times);
    return boxed(track, placed, smooth_placements(times, placed, frame_times));
}

/// Whether something may have this size and speed.
bool is_plausible(const BoxTrack& box) {
    const PoseTrack& track = box.world_from_box;
    double fastest = 0.0;   // over half a second, at least
    for (std::size_t i = 0, j = 0; j < track.pose.size(); ++j) {
        while (track.time_s[j] - track.time_s[i + 1 < j ? i + 1 : i] >= kSpeedOver_s) ++i;
        const double seconds = track.time_s[j] - track.time_s[i];
        if (seconds >= kSpeedOver_s)
            fastest = std::max(fastest, glm::distance(track.pose[j].translation, track.pose[i].translation) / seconds);
    }
    return box.size_m.x < kLongest_m && box.size_m.y < kWidest_m && box.size_m.z < kTallest_m && fastest > kSlowest_mps &&
           fastest < kFastest_mps;
}

/// The box of a track of which other frames say that it moved, without what they say stayed; nothing where they do not say so.
std::optional<BoxTrack> proven_box(const Visibility& visibility, Track& track) {
    Evidence sum;
    std::size_t moved = 0;
    const BoxTrack box = box_of(track);
    for (Observation& o : track.seen) {
        const Evidence evidence = sift(visibility, o.cluster, box);
        sum += evidence;
        moved += evidence.says_moved();
    }
    if (!sum.says_moved() || double(moved) < kProvenShare * double(track.seen.size())) return std::nullopt;
    std::erase_if(track.seen, [](const Observation& o) { return o.cluster.points_m.size() < kFewestPoints; });
    if (!moves(track)) return std::nullopt;
    const BoxTrack result = box_of(track);
    return is_plausible(result) ? std::optional(result) : std::nullopt;
}

/// Those of all tracks, of which each process of a team looks at its share.
std::vector<BoxTrack> proven_boxes(Visibility& visibility, std::vector<Track>& tracks, const Progress& progress, const Team& team) {
    const Team::Share share = team.share(tracks.size());
    for (std::size_t i = share.begin; i < share.end; ++i)
        for (const Observation& o : tracks[i].seen) visibility.announce(o.cluster.points_m);
    std::vector<std::optional<BoxTrack>> found(share.end - share.begin);
    for_each_told(found.size(), progress, "paths of movers",
                  [&](std::size_t i) { found[i] = proven_box(visibility, tracks[share.begin + i]); });
    struct Head {
        glm::dvec3 size_m;
        std::uint64_t n_poses;
    };
    std::vector<Head> heads;
    std::vector<double> times_s;
    std::vector<Pose> poses;
    for (const std::optional<BoxTrack>& box : found) {
        if (!box) continue;
        const PoseTrack& track = box->world_from_box;
        heads.push_back({box->size_m, track.pose.size()});
        times_s.insert(times_s.end(), track.time_s.begin(), track.time_s.end());
        poses.insert(poses.end(), track.pose.begin(), track.pose.end());
    }
    heads = team.joined(std::move(heads)), times_s = team.joined(std::move(times_s)), poses = team.joined(std::move(poses));
    std::vector<BoxTrack> boxes;
    std::ptrdiff_t at = 0;
    for (const Head& head : heads) {
        const std::ptrdiff_t end = at + std::ptrdiff_t(head.n_poses);
        boxes.push_back({"", kDiscoveredCategory, head.size_m,
                         {{times_s.begin() + at, times_s.begin() + end}, {poses.begin() + at, poses.begin() + end}}});
        at = end;
    }
    return boxes;
}

/// Whether a track is mostly inside another's box: a part of it that was a group of its own for a while.
bool is_part_of(const BoxTrack& part, const BoxTrack& whole) {
    const double margin = std::max(whole.size_m.x, whole.size_m.y) < kVehicle_m ? kFragment_m : kVehicleFragment_m;
    std::size_t inside = 0;
    for (std::size_t i = 0; i < part.world_from_box.time_s.size(); ++i) {
        const double t_s = part.world_from_box.time_s[i];
        inside += whole.present(t_s) && whole.holds(part.world_from_box.pose[i].translation, t_s, margin);
    }
    return 2 * inside > part.world_from_box.time_s.size();
}

std::vector<BoxTrack> without_parts(std::vector<BoxTrack> boxes) {
    std::stable_sort(boxes.begin(), boxes.end(),
                     [](const BoxTrack& a, const BoxTrack& b) { return a.world_from_box.time_s.size() > b.world_from_box.time_s.size(); });
    std::vector<BoxTrack> kept;
    for (const BoxTrack& box : boxes)
        if (std::none_of(kept.begin(), kept.end(), [&](const BoxTrack& other) { return is_part_of(box, other); })) kept.push_back(box);
    return kept;
}

/// What one LiDAR has seen move.
std::vector<BoxTrack> discovered_by(int lidar, const Sequence& sequence, std::vector<int> positions, const InitialiseOptions& options,
                                    const Progress& progress, const Team& team) {
    std::erase_if(positions, [&](int position) { return sequence.frames[std::size_t(position)].lidar != lidar; });
    std::vector<double> times;
    for (const int position : positions) times.push_back(sequence.frames[std::size_t(position)].time_s);
    Visibility visibility(sequence, positions);
    std::vector<Track> tracks =
        link(find_mover_clusters(sequence, positions, visibility, options, progress, team), times, sequence.world_from_vehicle);
    std::erase_if(tracks, [&](const Track& track) { return !moves(track) || rides_along(track, sequence.world_from_vehicle); });
    join_parts(tracks);
    return without_parts(proven_boxes(visibility, tracks, progress, team));
}

/// Adds what another LiDAR has seen move. Of a mover that is there already the box stays, unless the other saw it half as long again: the
/// longer of two paths of about the same length need not be the better one, but the end of a shorter one is where it is lost.
void add_movers(std::vector<BoxTrack>& boxes, std::vector<BoxTrack> others) {
    for (BoxTrack& other : others) {
        const auto is_same = [&](const BoxTrack& b) { return is_part_of(other, b) || is_part_of(b, other); };
        const auto stays = [&](const BoxTrack& b) { return 2 * other.world_from_box.time_s.size() <= 3 * b.world_from_box.time_s.size(); };
        if (std::ranges::any_of(boxes, [&](const BoxTrack& b) { return is_same(b) && stays(b); })) continue;
        std::erase_if(boxes, is_same);
        boxes.push_back(std::move(other));
    }
}

}  // namespace

std::vector<BoxTrack> discover_tracks(const Sequence& sequence, const std::vector<int>& train_positions, const InitialiseOptions& options,
                                      const Progress& progress, const Team& team) {
    std::vector<BoxTrack> boxes;
    for (int lidar = 0; lidar < int(sequence.lidars.size()); ++lidar)   // two sweeps at one time would see a mover twice in a track
        add_movers(boxes, discovered_by(lidar, sequence, train_positions, options, progress, team));
    for (std::size_t i = 0; i < boxes.size(); ++i) boxes[i].id = fmt::format("mover-{}", i);
    return boxes;
}

}  // namespace relidar
