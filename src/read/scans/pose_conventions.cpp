// SPDX-License-Identifier: Apache-2.0
#include "read/scans/pose_conventions.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_set>
#include <utility>

#include <fmt/format.h>

#include "base/geometry/cell_key.hpp"
#include "read/scans/stamped_log.hpp"

namespace relidar::read {
namespace {

// Minimum mean x component of the unit motion vectors in the vehicle frame.
constexpr double kMinForward = 0.9;
// Another convention is used only if it increases the mean x component, and the share of
// overlapping points, by these amounts.
constexpr double kMoreForward = 0.3, kMoreOverlap = 0.02;
constexpr std::size_t kFewestSteps = 3;
constexpr double kOverlapCell_m = 0.5;  // edge length of the cells in which the overlap of scans is counted
constexpr float kMinComparedRange_m = 3.0f,
                kMaxComparedRange_m = 40.0f;  // only points in this interval of ranges are compared

bool is_outside_overlap(const glm::vec3& point_m) {
    const float range_m = glm::length(point_m);
    return !(range_m > kMinComparedRange_m && range_m < kMaxComparedRange_m);
}

// Change of the mean upright component: maximum decrease with another convention, and
// increase that means that the vehicle was upside down.
constexpr double kLessUpright = 0.1, kMoreUpright = 0.5;
// Note that the order of the quaternions is uncertain.
constexpr const char* kQuaternionOrder = "quaternion_order";

double mean_upright(const PoseTrack& track) {
    double sum = 0.0;
    for (const Pose& pose : track.pose) sum += (pose.rotation * glm::dvec3(0, 0, 1)).z;
    return sum / double(track.pose.size());
}

constexpr std::size_t kScanPairs = 5;  // number of pairs of scans that are compared

std::vector<glm::vec3> vehicle_points(const Log& sequence, const Frame& frame) {
    const Pose& mounting = sequence.lidar_of(frame).vehicle_from_sensor;
    const RayTable& rays = frame.scan.rays;
    std::vector<glm::vec3> points_m;
    for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
        if (const float range_m = frame.scan.range_m[i]; range_m > 0.0f)
            points_m.emplace_back(mounting * glm::dvec3(rays.origin[i] + range_m * rays.direction[i]));
    return points_m;
}

/// Selects pairs of the first LiDAR, evenly spread over the log.
ScanPairs collect_pairs(const Log& sequence) {
    std::vector<const Frame*> frames;
    for (const Frame& frame : sequence.frames)
        if (frame.lidar == 0 && frame.scan.count_returns() > 0) frames.push_back(&frame);
    ScanPairs pairs;
    const std::size_t n = frames.empty() ? 0 : std::min(kScanPairs, frames.size() - 1);
    for (std::size_t k = 0; k < n; ++k) {
        const std::size_t i = k * (frames.size() - 1) / n;
        pairs.add_scan_pair(frames[i]->time_s, vehicle_points(sequence, *frames[i]), frames[i + 1]->time_s,
                            vehicle_points(sequence, *frames[i + 1]));
    }
    return pairs;
}

}  // namespace

void ScanPairs::add_scan_pair(double first_time_s, std::vector<glm::vec3> first_points_m,
                              double second_time_s, std::vector<glm::vec3> second_points_m) {
    std::erase_if(first_points_m, is_outside_overlap);
    std::erase_if(second_points_m, is_outside_overlap);
    if (!first_points_m.empty() && !second_points_m.empty())
        pairs_.push_back(
            {first_time_s, second_time_s, std::move(first_points_m), std::move(second_points_m)});
}

double ScanPairs::overlap_fraction(const PoseTrack& world_from_vehicle) const {
    double sum = 0.0;
    for (const OverlapScanPair& pair : pairs_) {
        const Pose first_from_second =
            inverse(world_from_vehicle.pose_at(pair.first_s)) * world_from_vehicle.pose_at(pair.second_s);
        std::unordered_set<std::uint64_t> cells;
        for (const glm::vec3& p : pair.first_m) cells.insert(grid_key(glm::dvec3(p), kOverlapCell_m));
        std::size_t n = 0;
        for (const glm::vec3& p : pair.second_m)
            n += cells.contains(grid_key(first_from_second * glm::dvec3(p), kOverlapCell_m));
        sum += double(n) / double(pair.second_m.size());
    }
    return pairs_.empty() ? 0.0 : sum / double(pairs_.size());
}

std::size_t choose_poses(const std::vector<PoseReading>& interpretations,
                         const ScanPairReader& read_scan_pairs_or_null, const std::string& where,
                         Notes& notes) {
    std::vector<double> forward, upright;
    for (const PoseReading& reading : interpretations) {
        const auto driving = read::driving_direction(reading.world_from_vehicle);
        forward.push_back(driving.n_steps < kFewestSteps ? 0.0 : driving.mean.x);
        upright.push_back(mean_upright(reading.world_from_vehicle));
    }
    const auto is_forward = [&](std::size_t k) {
        return forward[k] >= kMinForward && forward[k] >= forward[0] + kMoreForward;
    };
    // Only the scans can show that a vehicle drives backward.
    const auto is_possible = [&](std::size_t k) {
        return is_forward(k) || (std::abs(forward[k]) >= kMinForward &&
                                 (forward[0] < kMinForward || upright[k] > upright[0] + kMoreUpright ||
                                  (forward[k] < 0.0 && !interpretations[k].needs_scans)));
    };
    std::vector<std::size_t> possible;
    for (std::size_t k = 1; k < interpretations.size(); ++k)
        if (is_possible(k)) possible.push_back(k);
    if (possible.empty()) return 0;
    const ScanPairs scans = read_scan_pairs_or_null ? read_scan_pairs_or_null() : ScanPairs();
    const double first_overlap = scans.overlap_fraction(interpretations[0].world_from_vehicle);
    std::size_t best = 0, undecided = 0;
    double best_overlap = first_overlap + kMoreOverlap;
    for (const std::size_t k : possible) {
        const PoseReading& reading = interpretations[k];
        const double overlap = scans.overlap_fraction(reading.world_from_vehicle);
        if (scans.empty()) {
            if (reading.needs_scans || best > 0 || upright[k] < upright[0] - kLessUpright ||
                !(is_forward(k) || upright[k] > upright[0] + kMoreUpright))
                continue;
            // A vehicle that drives backward looks like one that drives forward with
            // another order of the quaternion.
            (forward[0] <= -kMinForward || !is_forward(k) ? undecided : best) = k;
        } else if (overlap > best_overlap) {
            best = k;
            best_overlap = overlap;
        } else if (is_forward(k) && !reading.needs_scans && overlap >= first_overlap - kMoreOverlap) {
            undecided = k;
        }
    }
    if (best > 0)
        notes.push_back(
            fmt::format("{}: poses are read as {}, because the vehicle then moves {:.2f} m {} per metre of "
                        "its path{}, but {:.2f} m forward if poses are read as {}",
                        where, interpretations[best].about, std::abs(forward[best]),
                        forward[best] < 0.0 ? "backward" : "forward",
                        scans.empty() ? "" : " and consecutive scans overlap better", forward[0],
                        interpretations[0].about));
    else if (undecided > 0)
        notes.push_back(
            {interpretations[undecided].about == kScalarLast ? kQuaternionOrder : "", -1,
             fmt::format("{}: the convention of the poses is uncertain: the vehicle moves {:.2f} m forward "
                         "per metre of its path with poses that are read as {}, but {:.2f} m with {}; if "
                         "these poses are wrong, add a first line with the names of the columns",
                         where, forward[0], interpretations[0].about, forward[undecided],
                         interpretations[undecided].about)});
    return best;
}

void fix_inverted_poses(Log& sequence) {
    if (!sequence.has_poses) return;
    PoseTrack world_track = sequence.world_from_vehicle;
    for (Pose& pose : world_track.pose) pose.translation += sequence.world_offset_m;
    PoseTrack inverted_track = world_track, other_order = world_track;
    for (Pose& pose : inverted_track.pose) pose = inverse(pose);
    for (Pose& pose : other_order.pose) {
        const glm::dquat q = pose.rotation;
        pose.rotation = glm::dquat(q.z, q.w, q.x, q.y);
    }
    std::vector<PoseReading> readings = {{"world-from-sensor poses", sequence.world_from_vehicle},
                                         {"sensor-from-world poses", std::move(inverted_track), true}};
    // The reader had no scans, which now decide the order of the quaternions.
    const auto undecided = std::ranges::find(sequence.notes, kQuaternionOrder, &Note::id);
    if (undecided != sequence.notes.end()) {
        readings[0].about = kScalarFirst;
        readings.push_back({kScalarLast, std::move(other_order)});
        sequence.notes.erase(undecided);
    }
    const auto read_pairs = [&] { return collect_pairs(sequence); };
    Notes notes;
    const std::size_t best = choose_poses(readings, read_pairs, sequence.source, notes);
    // Now the order is final, so that a converted log keeps the text.
    for (const Note& note : notes) sequence.notes.push_back(note.text);
    if (best == 0) return;
    set_trajectory(sequence, readings[best].world_from_vehicle);
    sequence.world_offset_m = glm::dvec3(0.0);
    sequence.georeference.reset();
    centre_log(sequence);
}

}  // namespace relidar::read
