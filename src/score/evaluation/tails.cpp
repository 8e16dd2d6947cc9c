// SPDX-License-Identifier: Apache-2.0
// Counts the points in comet tails: points at a position where a moving box was or will
// be, but is not now.
#include "score/evaluation/tails.hpp"

#include <algorithm>

#include "base/parallel.hpp"

namespace relidar {
namespace {

// Boxes at the time of the point are enlarged by this margin, because labels do not fit
// objects exactly.
constexpr double kNowMargin_m = 0.3;
constexpr double kGround_m = 0.3;

/// A moving box with all its labelled poses. Together, they cover the volume that the box
/// sweeps.
struct Swept {
    const BoxTrack* box;
    std::vector<Pose> box_from_world;
    glm::dvec3 low{1e30}, high{-1e30};  ///< bounds of the centres
};

std::vector<Swept> list_swept_boxes(const Sequence& sequence) {
    std::vector<Swept> swept;
    for (const BoxTrack& box : sequence.boxes) {
        if (!box.is_moving()) continue;
        Swept& s = swept.emplace_back();
        s.box = &box;
        for (const Pose& pose : box.world_from_box.pose) {
            s.box_from_world.push_back(inverse(pose));
            s.low = glm::min(s.low, pose.translation);
            s.high = glm::max(s.high, pose.translation);
        }
    }
    return swept;
}

bool is_in_swept_box(const Swept& swept, const glm::dvec3& point_m) {
    const glm::dvec3 half = 0.5 * swept.box->size_m;
    const double reach = glm::length(half);
    if (glm::any(glm::lessThan(point_m, swept.low - reach)) ||
        glm::any(glm::greaterThan(point_m, swept.high + reach)))
        return false;
    return std::any_of(swept.box_from_world.begin(), swept.box_from_world.end(),
                       [&](const Pose& box_from_world) {
                           const glm::dvec3 p = box_from_world * point_m;
                           return std::abs(p.x) <= half.x && std::abs(p.y) <= half.y && p.z <= half.z &&
                                  p.z >= -half.z + kGround_m;
                       });
}

/// Numbers of points: all points, and points in comet tails. A comet tail is the space
/// that a moving box occupies at other times, but not now.
struct Tail {
    std::size_t n_points = 0, n_tail = 0;
    std::vector<std::size_t> n_of_box;  ///< [swept] points in the tail of each box
    Tail& operator+=(const Tail& other) {
        n_points += other.n_points;
        n_tail += other.n_tail;
        n_of_box.resize(other.n_of_box.size());
        for (std::size_t k = 0; k < n_of_box.size(); ++k) n_of_box[k] += other.n_of_box[k];
        return *this;
    }
};

Tail measure_tails(const RangeImage& image, const std::vector<float>& points_m, const Sequence& sequence,
                   const std::vector<Swept>& swept, const SweepMoment& sweep) {
    // Number of rays that a thread processes at a time.
    constexpr std::size_t kRays = 2048;
    const Pose& mounted = sequence.lidars[std::size_t(sweep.lidar)].vehicle_from_sensor;
    return parallel_reduce(points_m.size(), kRays, [&](std::size_t begin, std::size_t end) {
        Tail part;
        part.n_of_box.resize(swept.size());
        std::vector<std::size_t> boxes;  // boxes that contain the point at some time of the log
        for (std::size_t i = begin; i < end; ++i) {
            if (!is_returned(image.drop_prob[i], points_m[i])) continue;
            ++part.n_points;
            const glm::dvec3 in_sensor(image.origin[i] + points_m[i] * image.direction[i]);
            const double t_s = compute_facing_time(sequence, in_sensor, sweep);
            const glm::dvec3 point_m = sequence.world_from_vehicle.at(t_s, mounted) * in_sensor;
            boxes.clear();
            for (std::size_t k = 0; k < swept.size(); ++k)
                if (is_in_swept_box(swept[k], point_m)) boxes.push_back(k);
            if (boxes.empty() || std::ranges::any_of(swept, [&](const Swept& actor) {
                    return actor.box->is_present(t_s) && actor.box->holds(point_m, t_s, kNowMargin_m);
                }))
                continue;
            ++part.n_tail;
            for (const std::size_t k : boxes) ++part.n_of_box[k];
        }
        return part;
    });
}

}  // namespace

TailCounts count_points_in_tails(const RangeImage& image, const std::vector<float>& points_m,
                                 const Sequence& sequence, const SweepMoment& sweep) {
    const std::vector<Swept> swept = list_swept_boxes(sequence);
    if (swept.empty()) return {};
    const Tail tail = measure_tails(image, points_m, sequence, swept, sweep);
    TailCounts counts;
    counts.share = double(tail.n_tail) / double(std::max<std::size_t>(tail.n_points, 1));
    for (std::size_t k = 0; k < swept.size(); ++k)
        counts.n_of_box[swept[k].box->id] = k < tail.n_of_box.size() ? tail.n_of_box[k] : 0;
    return counts;
}

}  // namespace relidar
