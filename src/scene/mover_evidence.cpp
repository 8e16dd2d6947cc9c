// SPDX-License-Identifier: Apache-2.0
// Counts the frames that support and that contradict the motion of an object. A static
// object has returns at its position whenever the position is visible. A moving object
// leaves the position empty. One empty observation is not enough, because beams also pass
// through glass, between leaves and past edges.
#include "scene/mover_evidence.hpp"

#include <algorithm>

namespace relidar {
namespace {

// Two returns closer than this can belong to the same static object, because poses and
// ranges have errors.
constexpr double kSamePlace_m = 0.2;
// Margin around the tracked box. Frames in which the enlarged box covers a point are not
// used for this point.
constexpr double kClear_m = 0.4;
// At least this share of the returns of a track must be proven to lie on a moving object.
constexpr double kToldShare = 0.25;
// Other frames confirm or disprove the motion of some returns. At least this share of
// these returns must be confirmed.
constexpr double kLeftShare = 0.85;
constexpr double kProvenShare = 0.5;  // motion must be proven in at least this share of a track's frames

}  // namespace

Evidence collect_evidence(const Visibility& visibility, const glm::dvec3& point_m, const BoxTrack& box) {
    const std::vector<double>& times = box.world_from_box.time_s;
    Evidence evidence;
    for (const std::uint32_t view : visibility.find_views_near(point_m)) {
        if (box.holds(point_m, std::clamp(visibility.time_s(view), times.front(), times.back()), kClear_m))
            continue;
        if (visibility.has_return_at(view, point_m, kSamePlace_m)) ++evidence.stayed;
        else if (visibility.look(view, point_m) == Sight::seen_through) ++evidence.left;
    }
    return evidence;
}

void EvidenceSum::operator+=(const EvidenceSum& other) {
    looks += other.looks;
    returns += other.returns, told += other.told, moved += other.moved;
    frames += other.frames, frames_moved += other.frames_moved;
}

bool EvidenceSum::has_proof_of_motion() const {
    return looks.has_proof_of_motion() && double(moved) >= kToldShare * double(returns) &&
           double(moved) >= kLeftShare * double(told) &&
           double(frames_moved) >= kProvenShare * double(frames);
}

EvidenceSum remove_static_returns(const Visibility& visibility, MoverCluster& cluster, const BoxTrack& box) {
    EvidenceSum sum;
    std::vector<glm::dvec3> kept;
    for (const glm::dvec3& p : cluster.points_m) {
        const Evidence evidence = collect_evidence(visibility, p, box);
        sum.looks += evidence;
        sum.told += evidence.has_observations();
        sum.moved += evidence.has_proof_of_motion();
        if (!evidence.has_proof_of_rest()) kept.push_back(p);
    }
    sum.returns = cluster.points_m.size();
    sum.frames = 1, sum.frames_moved = sum.looks.has_proof_of_motion();
    cluster.points_m = std::move(kept);
    cluster.centre_m = glm::dvec3(0.0);
    for (const glm::dvec3& p : cluster.points_m) cluster.centre_m += p / double(cluster.points_m.size());
    return sum;
}

}  // namespace relidar
