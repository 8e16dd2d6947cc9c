// SPDX-License-Identifier: Apache-2.0
#include "score/evaluation/tails.hpp"

#include <algorithm>

#include "base/parallel.hpp"

namespace relidar {
namespace {

// Labels do not fit objects exactly.
constexpr double kLabelMargin_m = 0.3;
constexpr double kMinTailHeight_m = 0.3;

struct SweptBoxVolume {
    const BoxTrack* box;
    std::vector<Pose> box_from_world;
    glm::dvec3 low{1e30}, high{-1e30};  ///< bounds of the centres
};

std::vector<SweptBoxVolume> sweep_boxes(const Log& sequence) {
    std::vector<SweptBoxVolume> swept;
    for (const BoxTrack& box : sequence.boxes) {
        if (!box.is_moving()) continue;
        SweptBoxVolume& s = swept.emplace_back();
        s.box = &box;
        for (const Pose& pose : box.world_from_box.pose) {
            s.box_from_world.push_back(inverse(pose));
            s.low = glm::min(s.low, pose.translation);
            s.high = glm::max(s.high, pose.translation);
        }
    }
    return swept;
}

bool is_in_volume(const SweptBoxVolume& swept_volume, const glm::dvec3& world_point_m) {
    const glm::dvec3 half = 0.5 * swept_volume.box->size_m;
    const double reach = glm::length(half);
    if (glm::any(glm::lessThan(world_point_m, swept_volume.low - reach)) ||
        glm::any(glm::greaterThan(world_point_m, swept_volume.high + reach)))
        return false;
    return std::any_of(swept_volume.box_from_world.begin(), swept_volume.box_from_world.end(),
                       [&](const Pose& box_from_world) {
                           const glm::dvec3 p = box_from_world * world_point_m;
                           return std::abs(p.x) <= half.x && std::abs(p.y) <= half.y && p.z <= half.z &&
                                  p.z >= -half.z + kMinTailHeight_m;
                       });
}

struct CometTailPointCounts {
    std::size_t n_points = 0, n_tail_points = 0;
    std::vector<std::size_t> n_of_box;  ///< [swept] points in the tail of each box
    CometTailPointCounts& operator+=(const CometTailPointCounts& other) {
        n_points += other.n_points;
        n_tail_points += other.n_tail_points;
        n_of_box.resize(other.n_of_box.size());
        for (std::size_t k = 0; k < n_of_box.size(); ++k) n_of_box[k] += other.n_of_box[k];
        return *this;
    }
};

CometTailPointCounts count_by_box(const RangeImage& image, const std::vector<float>& point_ranges_m,
                                  const Log& sequence, const std::vector<SweptBoxVolume>& swept_volumes,
                                  const SweepTiming& sweep) {
    // per step of a thread
    constexpr std::size_t kRaysPerBlock = 2048;
    const Pose& mounted = sequence.lidars[std::size_t(sweep.lidar)].vehicle_from_sensor;
    return parallel_sum(point_ranges_m.size(), kRaysPerBlock, [&](std::size_t begin, std::size_t end) {
        CometTailPointCounts part;
        part.n_of_box.resize(swept_volumes.size());
        std::vector<std::size_t> boxes;  // boxes that contain the point at some time of the log
        for (std::size_t i = begin; i < end; ++i) {
            if (!is_ray_returned(image.drop_prob[i], point_ranges_m[i])) continue;
            ++part.n_points;
            const glm::dvec3 in_sensor(image.origin[i] + point_ranges_m[i] * image.direction[i]);
            const double t_s = facing_time_s(sequence, in_sensor, sweep);
            const glm::dvec3 point_m = sequence.world_from_vehicle.mounted_pose_at(t_s, mounted) * in_sensor;
            boxes.clear();
            for (std::size_t k = 0; k < swept_volumes.size(); ++k)
                if (is_in_volume(swept_volumes[k], point_m)) boxes.push_back(k);
            if (boxes.empty() || std::ranges::any_of(swept_volumes, [&](const SweptBoxVolume& actor) {
                    return actor.box->is_observed(t_s) &&
                           actor.box->contains_point(point_m, t_s, kLabelMargin_m);
                }))
                continue;
            ++part.n_tail_points;
            for (const std::size_t k : boxes) ++part.n_of_box[k];
        }
        return part;
    });
}

}  // namespace

CometTailStatistics count_tail_points(const RangeImage& image, const std::vector<float>& point_ranges_m,
                                      const Log& sequence, const SweepTiming& sweep) {
    const std::vector<SweptBoxVolume> swept = sweep_boxes(sequence);
    if (swept.empty()) return {};
    const CometTailPointCounts point_counts = count_by_box(image, point_ranges_m, sequence, swept, sweep);
    CometTailStatistics counts;
    counts.share =
        double(point_counts.n_tail_points) / double(std::max<std::size_t>(point_counts.n_points, 1));
    for (std::size_t k = 0; k < swept.size(); ++k)
        counts.n_of_box[swept[k].box->id] = k < point_counts.n_of_box.size() ? point_counts.n_of_box[k] : 0;
    return counts;
}

}  // namespace relidar
