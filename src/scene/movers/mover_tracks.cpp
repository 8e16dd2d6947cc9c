// SPDX-License-Identifier: Apache-2.0
#include "scene/movers/mover_tracks.hpp"

#include <iterator>

namespace relidar {
namespace {

constexpr double kMaxGap_s = 0.35;  // maximum time without a matching cluster before a track is interrupted
constexpr double kLongestGap_s = 1.5;  // maximum gap across which two parts of a track are joined
constexpr std::size_t kEndsOfGap = 4;  // minimum number of observations before and after a gap
// Maximum number of observations from which a velocity is estimated, for the prediction
// of the next frame (kNextFrameVelocity) and across a gap in time (kGapVelocity).
constexpr std::size_t kNextFrameVelocity = 4, kGapVelocity = 10;
constexpr double kFirstSpeed_mps = 15.0;  // maximum speed of an object that has been observed only once
// Maximum distance between an object and its predicted position: kMaxPrediction_m plus
// kMaxPrediction_mps for each second since its last observation.
constexpr double kMaxPrediction_m = 0.7, kMaxPrediction_mps = 4.0;
// The velocities before and after a gap must both predict the motion across the gap. The
// maximum error is kMaxPrediction_m plus this many metres for each second of the gap.
constexpr double kMaxGapError_mps = 0.8;
constexpr double kMaxSpeedChange_mps = 2.0;
constexpr double kMaxRatio = 8.0;  // maximum change of an object's number of returns between frames
constexpr std::size_t kMinObservations = 6;
constexpr double kMinPath_m = 0.6;
constexpr double kMinStraightness = 0.5;  // minimum net motion / path length; the ratio of noise is small
constexpr double kEgoVehicleRadius_m = 4.0, kMaxRelativeMotion_m = 0.3;
constexpr double kVehiclePart_m = 1.2;      // smaller parts are not joined, because they can be people
constexpr double kMaxPartDistance_m = 1.5;  // maximum distance between the parts of one vehicle
// Maximum standard deviation of the offset between two parts of one vehicle. The offset
// varies with the visible side.
constexpr double kMaxOffsetSigma_m = 0.5;

/// Indices of two things that can belong together. The order puts the best match first.
struct Match {
    double cost;  ///< 0 (perfect) to 1 (just possible)
    std::size_t first, second;
    auto operator<=>(const Match&) const = default;
};
constexpr double kNoMatch = 2.0;  // cost of things that cannot belong together

glm::dvec3 velocity_between(const MoverCluster& first, const MoverCluster& second) {
    return (second.centre_m - first.centre_m) / std::max(second.time_s - first.time_s, 1e-3);
}
glm::dvec3 last_velocity(const MoverTrack& track, std::size_t n_max) {
    return velocity_between(
        track.observations[track.observations.size() - std::min(track.observations.size(), n_max)].cluster,
        track.last_cluster());
}
glm::dvec3 first_velocity(const MoverTrack& track, std::size_t n_max) {
    return velocity_between(track.observations.front().cluster,
                            track.observations[std::min(track.observations.size(), n_max) - 1].cluster);
}

/// Returns the distance, in the view from above, between a cluster and the predicted
/// position of a track, divided by the largest allowed distance. From 1 on, it is
/// another object. A label is an index in Log::boxes. In a labelled track, an equal label
/// costs 0, another never matches, and no label matches only outside the label's time.
double match_cost(const MoverTrack& track, const MoverCluster& cluster, double frame_time_s, const Log& log) {
    if (track.label != kNoLabel) {
        if (cluster.label != kNoLabel) return cluster.label == track.label ? 0.0 : kNoMatch;
        const PoseTrack& labels = log.boxes[std::size_t(track.label)].world_from_box;
        if (labels.contains_time(frame_time_s)) return kNoMatch;
    }
    const MoverCluster& last = track.last_cluster();
    const double gap_s = cluster.time_s - last.time_s;
    if (!(gap_s > 0.0 && gap_s < kMaxGap_s)) return kNoMatch;
    const double size_ratio = double(cluster.points_m.size()) / double(last.points_m.size());
    if (size_ratio > kMaxRatio || size_ratio < 1.0 / kMaxRatio) return kNoMatch;
    // With a single observation, the velocity is unknown.
    const double max_error_mps = track.observations.size() < 2 ? kFirstSpeed_mps : kMaxPrediction_mps;
    const double max_error_m = kMaxPrediction_m + max_error_mps * gap_s;
    const glm::dvec3 error_m =
        cluster.centre_m - last.centre_m - gap_s * last_velocity(track, kNextFrameVelocity);
    return glm::length(glm::dvec2(error_m)) / max_error_m;
}

/// Builds tracks frame by frame. A track is open while a cluster can continue it.
class OpenTrackSet {
public:
    explicit OpenTrackSet(const Log& log) : log_(log) {}

    /// Continues the open tracks with the clusters of the next frame, the best match
    /// first. Each remaining cluster starts a track.
    void link_frame(double frame_time_s, const std::vector<MoverCluster>& clusters) {
        std::erase_if(open_, [&](std::size_t t) { return has_ended(tracks_[t], frame_time_s); });
        std::vector<char> track_is_used(tracks_.size(), 0), cluster_is_used(clusters.size(), 0);
        for (const auto& [cost, track, cluster] : list_matches(frame_time_s, clusters)) {
            if (track_is_used[track] || cluster_is_used[cluster]) continue;
            track_is_used[track] = cluster_is_used[cluster] = 1;
            append(tracks_[track], frame_time_s, clusters[cluster]);
        }
        for (std::size_t c = 0; c < clusters.size(); ++c) {
            if (cluster_is_used[c]) continue;
            open_.push_back(tracks_.size());
            append(tracks_.emplace_back(), frame_time_s, clusters[c]);
        }
    }

    MoverTracks release_tracks() && { return std::move(tracks_); }

private:
    const Log& log_;
    MoverTracks tracks_;
    std::vector<std::size_t> open_;  // indices of the tracks that may continue

    /// Returns true if no cluster of a frame can continue a track. A labelled track stays
    /// open until its last label.
    bool has_ended(const MoverTrack& track, double frame_time_s) const {
        if (track.label != kNoLabel &&
            log_.boxes[std::size_t(track.label)].world_from_box.time_s.back() >= frame_time_s)
            return false;
        // match_cost() compares firing times of returns. They differ from frame times by
        // up to a sweep, so this limit is wider.
        return frame_time_s - track.observations.back().frame_time_s > 2.0 * kMaxGap_s;
    }
    /// Returns the pairs of an open track and a cluster of a frame, the best match first.
    std::vector<Match> list_matches(double frame_time_s, const std::vector<MoverCluster>& clusters) const {
        std::vector<Match> result;
        for (const std::size_t t : open_)
            for (std::size_t c = 0; c < clusters.size(); ++c) {
                const double cost = match_cost(tracks_[t], clusters[c], frame_time_s, log_);
                if (cost < 1.0) result.push_back({cost, t, c});
            }
        std::ranges::sort(result);
        return result;
    }
    void append(MoverTrack& track, double frame_time_s, const MoverCluster& cluster) const {
        track.observations.push_back(
            {frame_time_s, log_.world_from_vehicle.pose_at(cluster.time_s).translation, cluster});
        if (cluster.label != kNoLabel) track.label = cluster.label;
    }
};

/// Returns the longer side of the rectangle around a cluster, in the view from above.
double visible_width_m(const MoverCluster& cluster) {
    glm::dvec2 low(1e30), high(-1e30);
    for (const glm::dvec3& p : cluster.points_m) {
        low = glm::min(low, glm::dvec2(p));
        high = glm::max(high, glm::dvec2(p));
    }
    return std::max(high.x - low.x, high.y - low.y);
}

using ObservationPairs = std::vector<std::pair<std::size_t, std::size_t>>;

/// Returns pairs of indices of the observations of two tracks in the same frame.
ObservationPairs list_pairs(const MoverTrack& a, const MoverTrack& b) {
    ObservationPairs pairs;
    for (std::size_t i = 0, j = 0; i < a.observations.size() && j < b.observations.size();) {
        if (a.observations[i].frame_time_s < b.observations[j].frame_time_s) ++i;
        else if (b.observations[j].frame_time_s < a.observations[i].frame_time_s) ++j;
        else pairs.push_back({i++, j++});
    }
    return pairs;
}

/// Returns the smallest distance between two clusters in the view from above.
double distance_between_m(const MoverCluster& first, const MoverCluster& second) {
    double smallest_m = 1e30;
    for (const glm::dvec3& p : first.points_m)
        for (const glm::dvec3& q : second.points_m)
            smallest_m = std::min(smallest_m, glm::distance(glm::dvec2(p), glm::dvec2(q)));
    return smallest_m;
}

/// Returns true if the offset between the centres of two tracks hardly varies. Parts of
/// one vehicle keep their offset, while two vehicles move independently.
/// @param common observations of both tracks in the same frame
bool is_offset_constant(const MoverTrack& first, const MoverTrack& second, const ObservationPairs& common) {
    glm::dvec3 sum(0.0), squares(0.0);
    for (const auto& [i, j] : common) {
        const glm::dvec3 offset_m =
            second.observations[j].cluster.centre_m - first.observations[i].cluster.centre_m;
        sum += offset_m;
        squares += offset_m * offset_m;
    }
    const double n = double(common.size());
    // Variance = mean of the squares - square of the mean, for each axis.
    const glm::dvec3 variance = squares / n - sum / n * (sum / n);
    return variance.x + variance.y < kMaxOffsetSigma_m * kMaxOffsetSigma_m;
}

/// Returns true if two tracks are parts of one vehicle. Example: if the beams miss the
/// roof of a van, its tail and its cabin form separate clusters.
bool is_same_vehicle(const MoverTrack& track, const MoverTrack& other_track) {
    constexpr std::size_t kMinCommonFrames = 4;
    if (other_track.label != kNoLabel) return false;
    const ObservationPairs common = list_pairs(track, other_track);
    if (common.size() < kMinCommonFrames || 2 * common.size() < other_track.observations.size()) return false;
    // In the middle of the common frames, both parts are large and near each other.
    const auto& [i, j] = common[common.size() / 2];
    const MoverCluster& cluster = track.observations[i].cluster;
    const MoverCluster& other = other_track.observations[j].cluster;
    if (std::min(visible_width_m(cluster), visible_width_m(other)) < kVehiclePart_m) return false;
    if (distance_between_m(cluster, other) > kMaxPartDistance_m) return false;
    return is_offset_constant(track, other_track, common);
}

/// Returns how badly a later track continues an earlier track after a gap in time:
///   max(error of the predicted motion / its limit, change of velocity / its limit)
/// Predicts the motion across the gap from each track. A value above 1 means that the
/// tracks belong to different objects.
double gap_cost(const MoverTrack& earlier, const MoverTrack& later) {
    if (earlier.label != kNoLabel && later.label != kNoLabel) return kNoMatch;
    if (std::min(earlier.observations.size(), later.observations.size()) < kEndsOfGap) return kNoMatch;
    const double gap_s = later.observations.front().cluster.time_s - earlier.last_cluster().time_s;
    if (!(gap_s > 0.0 && gap_s < kLongestGap_s)) return kNoMatch;
    const glm::dvec3 before_mps = last_velocity(earlier, kGapVelocity),
                     after_mps = first_velocity(later, kGapVelocity);
    const glm::dvec3 moved_m = later.observations.front().cluster.centre_m - earlier.last_cluster().centre_m;
    const double error_m = std::max(glm::length(glm::dvec2(moved_m - gap_s * before_mps)),
                                    glm::length(glm::dvec2(moved_m - gap_s * after_mps)));
    const double speed_change_mps = glm::length(glm::dvec2(before_mps - after_mps));
    return std::max(error_m / (kMaxPrediction_m + kMaxGapError_mps * gap_s),
                    speed_change_mps / kMaxSpeedChange_mps);
}

/// Returns the pairs of tracks that may be parts of the same object, with a gap in time
/// between them and a gap_cost() below its limit 1. Sorts the pairs by this cost.
/// @param tracks sorted by their first frames
std::vector<Match> find_gap_pairs(const MoverTracks& tracks) {
    std::vector<Match> pairs;
    const auto start_s = [](const MoverTrack& track) { return track.observations.front().frame_time_s; };
    for (std::size_t earlier = 0; earlier < tracks.size(); ++earlier) {
        const double end_s = tracks[earlier].observations.back().frame_time_s;
        const auto first_later = std::ranges::upper_bound(tracks, end_s, {}, start_s);
        for (auto later = first_later; later != tracks.end(); ++later) {
            if (start_s(*later) >= end_s + kLongestGap_s) break;
            const double cost = gap_cost(tracks[earlier], *later);
            if (cost < 1.0) pairs.push_back({cost, earlier, std::size_t(later - tracks.begin())});
        }
    }
    std::ranges::sort(pairs);
    return pairs;
}

/// Joins tracks of the same object across gaps, unless both have a label. The parts of an
/// object form a chain: each part is linked to the part that continues it.
MoverTracks join_gaps(MoverTracks tracks) {
    // Links each track to at most one later and at most one earlier track, the best
    // pairs first. Both arrays have one entry per track.
    const std::size_t none = tracks.size();  // marks the end of a chain
    std::vector<std::size_t> next(tracks.size(), none);
    std::vector<char> has_previous(tracks.size(), 0);
    for (const auto& [cost, earlier, later] : find_gap_pairs(tracks))
        if (next[earlier] == none && !has_previous[later]) {
            next[earlier] = later;
            has_previous[later] = 1;
        }
    // Starts a chain at each track that continues no other, and appends the later parts
    // to the newest joined track. Two labels are two objects, so a second label in the
    // chain begins a new joined track, which gets the parts after it.
    MoverTracks joined;
    for (std::size_t first = 0; first < tracks.size(); ++first) {
        if (has_previous[first]) continue;
        joined.push_back(std::move(tracks[first]));
        for (std::size_t part = next[first]; part != none; part = next[part]) {
            MoverTrack& newest = joined.back();
            if (newest.label != kNoLabel && tracks[part].label != kNoLabel) {
                joined.push_back(std::move(tracks[part]));
                continue;
            }
            newest.label = std::max(newest.label, tracks[part].label);  // kNoLabel is the smallest
            std::ranges::move(tracks[part].observations, std::back_inserter(newest.observations));
        }
    }
    return joined;
}

}  // namespace

std::vector<double> MoverTrack::times_s() const {
    std::vector<double> times;
    for (const MoverObservation& o : observations) times.push_back(o.cluster.time_s);
    return times;
}

MoverTracks link_clusters(const ClustersByFrame& clusters, const std::vector<double>& t_s, const Log& log) {
    OpenTrackSet open(log);
    for (std::size_t f = 0; f < clusters.size(); ++f) open.link_frame(t_s[f], clusters[f]);
    return join_gaps(std::move(open).release_tracks());
}

bool is_moving_track(const MoverTrack& track) {
    if (track.observations.size() < kMinObservations) return false;
    std::vector<glm::dvec3> centres;  // without motion in z
    for (const MoverObservation& o : track.observations)
        centres.push_back(o.cluster.centre_m * glm::dvec3(1.0, 1.0, 0.0));
    const KinematicPath path = smooth_path(track.times_s(), centres);
    double path_m = 0.0;
    for (std::size_t i = 1; i < path.size(); ++i)
        path_m += glm::distance(path[i - 1].position_m, path[i].position_m);
    const double net_m = glm::distance(path.front().position_m, path.back().position_m);
    // A path that wanders around one position is long but ends near its start.
    return net_m > kMinPath_m && net_m > kMinStraightness * path_m;
}

bool is_ego_part(const MoverTrack& track, const PoseTrack& world_from_vehicle) {
    std::vector<glm::dvec3> in_vehicle_m;
    for (const MoverObservation& o : track.observations)
        in_vehicle_m.push_back(inverse(world_from_vehicle.pose_at(o.cluster.time_s)) * o.cluster.centre_m);
    // More than three quarters of the observations must be near that of the middle frame.
    const glm::dvec3 middle_m = in_vehicle_m[in_vehicle_m.size() / 2];
    const auto n_near = std::ranges::count_if(in_vehicle_m, [&](const glm::dvec3& point) {
        return glm::distance(point, middle_m) < kMaxRelativeMotion_m;
    });
    return glm::length(middle_m) < kEgoVehicleRadius_m &&
           n_near > std::ptrdiff_t(in_vehicle_m.size() * 3 / 4);
}

void merge_tracks(MoverTracks& tracks) {
    // Longest first, so that a track absorbs only shorter tracks.
    std::stable_sort(tracks.begin(), tracks.end(), [](const MoverTrack& first, const MoverTrack& second) {
        return first.observations.size() > second.observations.size();
    });
    for (std::size_t longer = 0; longer < tracks.size(); ++longer)
        for (std::size_t shorter = longer + 1; shorter < tracks.size(); ++shorter) {
            if (!is_same_vehicle(tracks[longer], tracks[shorter])) continue;
            // Frames that show only the shorter track add no observation.
            for (const auto& [i, j] : list_pairs(tracks[longer], tracks[shorter]))
                tracks[longer].observations[i].cluster.merge_cluster(tracks[shorter].observations[j].cluster);
            tracks.erase(tracks.begin() + std::ptrdiff_t(shorter));
            --shorter;  // the next track has moved to this index
        }
}

}  // namespace relidar
