// SPDX-License-Identifier: Apache-2.0
#include "score/evaluation/actor_scores.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include <relidar/scene/labels.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/score/evaluation.hpp>
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "score/metrics/image_errors.hpp"

namespace relidar {
namespace {

using metrics::mean_value;

// Margins around a box for its points and for the rays that hit it.
constexpr double kBoxMargin_m = 0.1, kSilhouetteMargin_m = 0.3;
// Lower points belong to the ground.
constexpr double kGroundHeight_m = 0.15;
constexpr double kInlierDistance_m = 0.03, kLargeError_m = 0.3;
constexpr double kMaxMotionPerSweep_m = 2.0;  // Maximum distance that a box moves within one sweep.
// Labelled boxes with fewer real points are not scored.
constexpr std::size_t kMinRealPoints = 10;

struct BoxInScan {
    const Log& log;
    const SweepTiming& sweep;
    const BoxTrack& box;
    /// centre of the box at the time of the scan, sensor frame
    const glm::dvec3 centre_m =
        inverse(world_from_sensor(sweep.time_s)) * box.world_from_box.pose_at(sweep.time_s).translation;

    Pose world_from_sensor(double t_s) const {
        return log.world_from_vehicle.mounted_pose_at(
            t_s, log.lidars[std::size_t(sweep.lidar)].vehicle_from_sensor);
    }
    /// At the time when the LiDAR's head faces the point. Nothing if the point is far
    /// away.
    std::optional<glm::dvec3> to_box(const glm::dvec3& sensor_point_m) const {
        if (glm::distance(sensor_point_m, centre_m) >
            0.5 * glm::length(box.size_m) + kSilhouetteMargin_m + kMaxMotionPerSweep_m)
            return std::nullopt;
        const double t_s = facing_time_s(log, sensor_point_m, sweep);
        return inverse(box.world_from_box.pose_at(t_s)) * (world_from_sensor(t_s) * sensor_point_m);
    }
    bool contains(const std::optional<glm::dvec3>& box_point_m, double margin_m) const {
        const glm::dvec3 half = 0.5 * box.size_m;
        return box_point_m && std::abs(box_point_m->x) <= half.x + margin_m &&
               std::abs(box_point_m->y) <= half.y + margin_m && box_point_m->z <= half.z + margin_m &&
               box_point_m->z >= kGroundHeight_m - half.z;
    }
};

/// Returns how well the simulated and the real outline of a box agree:
///   F1 = n_both / (n_both + (n_missed + n_false) / 2)
/// as numerator and denominator, so that those of several boxes can be added.
std::pair<double, double> silhouette_f1(const MovingBoxPoints& points) {
    return {double(points.n_both), double(points.n_both) + 0.5 * double(points.n_missed + points.n_false)};
}

/// Adds the median absolute error, the median error (bias), and the fraction of errors
/// above kLargeError_m.
void add_range_errors(MetricValues& row, const std::string& name_prefix,
                      const std::vector<double>& errors_m) {
    if (errors_m.empty()) return;
    std::vector<double> absolute_m, large;
    for (const double error : errors_m) {
        absolute_m.push_back(std::abs(error));
        large.push_back(std::abs(error) > kLargeError_m ? 1.0 : 0.0);
    }
    row[name_prefix + "medae_m"] = compute_median(absolute_m);
    row[name_prefix + "bias_m"] = compute_median(errors_m);
    row[name_prefix + "above_30cm"] = mean_value(large);
}

/// All people and cyclists, or all other labelled boxes. All of them have real points.
struct BoxGroupErrors {
    std::vector<double> range_error_m, chamfer_m, inlier_flags;
    double both = 0.0, either = 0.0;

    void add_box(const MovingBoxPoints& points) {
        range_error_m.insert(range_error_m.end(), points.range_error_m.begin(), points.range_error_m.end());
        const auto [box_both, box_either] = silhouette_f1(points);
        both += box_both;
        either += box_either;
        if (points.simulated_m.empty()) return;  // without simulated points, only F1 can be computed
        const std::vector<double> to_real = nearest_distances_m(points.simulated_m, points.real_m);
        // Chamfer distance: mean distance to the nearest real point, plus the reverse.
        chamfer_m.push_back(mean_value(to_real) +
                            mean_value(nearest_distances_m(points.real_m, points.simulated_m)));
        for (const double d : to_real) inlier_flags.push_back(d <= kInlierDistance_m ? 1.0 : 0.0);
    }
    void add_to_row(MetricValues& row, const std::string& name_prefix) const {
        add_range_errors(row, name_prefix, range_error_m);
        if (either > 0.0) row[name_prefix + "f1"] = both / either;
        if (chamfer_m.empty()) return;
        row[name_prefix + "cd_m"] = mean_value(chamfer_m);
        row[name_prefix + "3cm"] = mean_value(inlier_flags);
    }
};

bool is_person_or_cyclist(const std::string& category) {
    const ObjectKind kind = parse_kind(category);
    return kind == ObjectKind::person || kind == ObjectKind::cyclist;
}

// Comet tails: wrong points at positions that a moving actor occupies at another time.

// Labels do not fit objects exactly.
constexpr double kLabelMargin_m = 0.3;
constexpr double kMinTailHeight_m = 0.3;

struct SweptBoxVolume {
    const BoxTrack* box;
    std::vector<Pose> box_from_world;   ///< poses of the box in the full log
    glm::dvec3 low{1e30}, high{-1e30};  ///< bounds of the box's centre at all poses, world frame
};

/// Returns the volume of each moving box: the space that it occupies at any of its poses.
std::vector<SweptBoxVolume> sweep_boxes(const Log& log) {
    std::vector<SweptBoxVolume> volumes;
    for (const BoxTrack& box : log.boxes) {
        if (!box.is_moving()) continue;
        SweptBoxVolume& volume = volumes.emplace_back();
        volume.box = &box;
        for (const Pose& world_from_box : box.world_from_box.pose) {
            volume.box_from_world.push_back(inverse(world_from_box));
            volume.low = glm::min(volume.low, world_from_box.translation);
            volume.high = glm::max(volume.high, world_from_box.translation);
        }
    }
    return volumes;
}

/// Returns true if the box contains a point at any of its poses. Its lowest
/// kMinTailHeight_m are left out, because points there belong to the ground.
bool is_in_volume(const SweptBoxVolume& volume, const glm::dvec3& world_point_m) {
    const glm::dvec3 half = 0.5 * volume.box->size_m;
    // A fast test: the box is within half its diagonal of the bounds of its centre.
    const double half_diagonal = glm::length(half);
    if (glm::any(glm::lessThan(world_point_m, volume.low - half_diagonal)) ||
        glm::any(glm::greaterThan(world_point_m, volume.high + half_diagonal)))
        return false;
    return std::ranges::any_of(volume.box_from_world, [&](const Pose& box_from_world) {
        const glm::dvec3 box_point = box_from_world * world_point_m;
        const bool is_in_footprint = std::abs(box_point.x) <= half.x && std::abs(box_point.y) <= half.y;
        return is_in_footprint && box_point.z <= half.z && box_point.z >= -half.z + kMinTailHeight_m;
    });
}

struct CometTailPointCounts {
    std::size_t n_points = 0, n_tail_points = 0;
    std::vector<std::size_t> n_of_box;  ///< [moving boxes] points in the tail of each box

    /// Fraction of all returned points that are in a tail.
    double share() const { return double(n_tail_points) / double(std::max<std::size_t>(n_points, 1)); }
    CometTailPointCounts& operator+=(const CometTailPointCounts& other) {
        n_points += other.n_points;
        n_tail_points += other.n_tail_points;
        n_of_box.resize(other.n_of_box.size());
        for (std::size_t k = 0; k < n_of_box.size(); ++k) n_of_box[k] += other.n_of_box[k];
        return *this;
    }
};

/// Returns the moving boxes whose tail contains a point: boxes that contain it at some
/// time of the log. Returns none if a moving box, enlarged by kLabelMargin_m, contains
/// the point at its own time: then, the point can be a correct return from this box.
/// @param t_s time of the point
/// @return indices into `volumes`
std::vector<std::size_t> find_tails(const std::vector<SweptBoxVolume>& volumes, const glm::dvec3& point_m,
                                    double t_s) {
    std::vector<std::size_t> tails;
    for (std::size_t k = 0; k < volumes.size(); ++k)
        if (is_in_volume(volumes[k], point_m)) tails.push_back(k);
    const auto contains_now = [&](const SweptBoxVolume& volume) {
        return volume.box->is_observed(t_s) && volume.box->contains_point(point_m, t_s, kLabelMargin_m);
    };
    if (!tails.empty() && std::ranges::any_of(volumes, contains_now)) tails.clear();
    return tails;
}

/// Counts the points of an image, and those in the comet tails of moving boxes. The time
/// of a point is when the LiDAR's head faces it.
/// @param point_ranges_m [n] range of the point on each ray of the image
/// @param swept_volumes  space that each moving box covers during the log
CometTailPointCounts count_tail_points(const RangeImage& image, const std::vector<float>& point_ranges_m,
                                       const Log& log, const std::vector<SweptBoxVolume>& swept_volumes,
                                       const SweepTiming& sweep) {
    constexpr std::size_t kRaysPerBlock = 2048;  // per step of a thread
    const Pose& vehicle_from_sensor = log.lidars[std::size_t(sweep.lidar)].vehicle_from_sensor;
    return parallel_sum(point_ranges_m.size(), kRaysPerBlock, [&](std::size_t begin, std::size_t end) {
        CometTailPointCounts counts;
        counts.n_of_box.resize(swept_volumes.size());
        for (std::size_t ray = begin; ray < end; ++ray) {
            if (!is_ray_returned(image.drop_prob[ray], point_ranges_m[ray])) continue;
            ++counts.n_points;
            const glm::dvec3 sensor_point_m(image.origin[ray] + point_ranges_m[ray] * image.direction[ray]);
            const double t_s = facing_time_s(log, sensor_point_m, sweep);
            // In the world. The vehicle moves during the sweep.
            const glm::dvec3 point_m =
                log.world_from_vehicle.mounted_pose_at(t_s, vehicle_from_sensor) * sensor_point_m;
            const std::vector<std::size_t> tails = find_tails(swept_volumes, point_m, t_s);
            if (!tails.empty()) ++counts.n_tail_points;
            for (const std::size_t box : tails) ++counts.n_of_box[box];
        }
        return counts;
    });
}

}  // namespace

MovingBoxPoints points_in_box(const RangeImage& rendered, const std::vector<float>& point_ranges_m,
                              const RangeImage& real, const Log& log, const SweepTiming& sweep,
                              const BoxTrack& box) {
    const BoxInScan in_scan{log, sweep, box};
    MovingBoxPoints result;
    for (std::size_t i = 0; i < point_ranges_m.size(); ++i) {
        const auto to_box = [&](const RangeImage& image, float range_m) {
            return in_scan.to_box(glm::dvec3(image.origin[i] + range_m * image.direction[i]));
        };
        // End points of ray i in the box frame; empty without a return or far away.
        std::optional<glm::dvec3> real_m, simulated_m;
        const bool is_simulated = is_ray_returned(rendered.drop_prob[i], point_ranges_m[i]);
        if (real.range_m[i] > 0.0f) real_m = to_box(real, real.range_m[i]);
        if (is_simulated) simulated_m = to_box(rendered, point_ranges_m[i]);
        if (in_scan.contains(simulated_m, kBoxMargin_m)) result.simulated_m.push_back(*simulated_m);
        if (in_scan.contains(real_m, kBoxMargin_m)) {
            result.real_m.push_back(*real_m);
            const double error_m = double(point_ranges_m[i]) - double(real.range_m[i]);
            if (is_simulated) result.range_error_m.push_back(error_m);
        }
        // F1 compares which rays hit the box, including those that miss it a little.
        const bool in_real = in_scan.contains(real_m, kSilhouetteMargin_m);
        const bool in_simulated = in_scan.contains(simulated_m, kSilhouetteMargin_m);
        if (in_real && in_simulated) ++result.n_both;
        if (in_real && !in_simulated) ++result.n_missed;
        if (in_simulated && !in_real) ++result.n_false;
    }
    return result;
}

FrameActorScores score_actors(const RangeImage& rendered, const std::vector<float>& point_ranges_m,
                              const RangeImage& real, const Log& log, const SweepTiming& sweep) {
    FrameActorScores scores;
    const std::vector<SweptBoxVolume> swept = sweep_boxes(log);
    if (swept.empty()) return scores;
    // Points at places where a moving box is only at other times (comet tails).
    const CometTailPointCounts tails = count_tail_points(rendered, point_ranges_m, log, swept, sweep);
    const CometTailPointCounts real_tails = count_tail_points(real, real.range_m, log, swept, sweep);
    scores.metrics["actors/tail_share"] = tails.share();
    scores.metrics["actors/tail_share_real"] = real_tails.share();
    BoxGroupErrors people, vehicles;
    for (std::size_t k = 0; k < swept.size(); ++k) {
        const BoxTrack& box = *swept[k].box;
        MovingBoxPoints points;  // none if the box is not in this frame
        if (box.is_observed(sweep.time_s))
            points = points_in_box(rendered, point_ranges_m, real, log, sweep, box);
        MetricValues row{{"points", double(points.simulated_m.size())},
                         {"points_real", double(points.real_m.size())}};
        add_range_errors(row, "range_", points.range_error_m);
        const auto [both, either] = silhouette_f1(points);
        if (either > 0.0) row["f1"] = both / either;
        row["tail"] = double(tails.n_of_box[k]);
        row["tail_real"] = double(real_tails.n_of_box[k]);
        scores.actors.push_back({.track = box.id,
                                 .category = name_of(class_of(box)),
                                 .metrics = row,
                                 .is_discovered = is_discovered(box)});
        // The groups contain only labelled boxes with enough real points.
        if (points.real_m.size() < kMinRealPoints || is_discovered(box)) continue;
        BoxGroupErrors& group = is_person_or_cyclist(box.category) ? people : vehicles;
        group.add_box(points);
    }
    people.add_to_row(scores.metrics, "actors/people_");
    vehicles.add_to_row(scores.metrics, "actors/vehicles_");
    return scores;
}

std::vector<ActorScore> average_scores(const std::vector<std::vector<ActorScore>>& scores_per_frame) {
    struct ActorSums {
        std::string category;
        bool is_discovered = false;
        MetricValues counts;  // numbers of points
        // Of the other metrics. A frame can lack some, so each has its own weights.
        MetricValues weighted_sums, weight_sums;
    };
    std::map<std::string, ActorSums> sums_by_track;
    for (const std::vector<ActorScore>& frame : scores_per_frame)
        for (const ActorScore& actor : frame) {
            ActorSums& sums = sums_by_track[actor.track];
            sums.category = actor.category;
            sums.is_discovered = actor.is_discovered;
            const double weight = actor.metrics.at("points_real");
            for (const auto& [name, value] : actor.metrics) {
                const bool is_count = name.starts_with("points") || name.starts_with("tail");
                if (is_count) {
                    sums.counts[name] += value;
                } else {
                    sums.weighted_sums[name] += weight * value;
                    sums.weight_sums[name] += weight;
                }
            }
        }
    std::vector<ActorScore> actors;
    for (const auto& [track, sums] : sums_by_track) {
        ActorScore& actor =
            actors.emplace_back(ActorScore{track, sums.category, sums.counts, sums.is_discovered});
        for (const auto& [name, sum] : sums.weighted_sums) {
            const double weight = sums.weight_sums.at(name);
            if (weight > 0.0) actor.metrics[name] = sum / weight;
        }
    }
    const auto share_of_large_errors = [](const ActorScore& actor) {
        const auto metric = actor.metrics.find("range_above_30cm");
        return metric == actor.metrics.end() ? -1.0 : metric->second;
    };
    std::ranges::stable_sort(actors, std::greater{}, share_of_large_errors);
    return actors;
}

std::optional<double> median_points_error(const std::vector<ActorScore>& actors) {
    std::vector<double> errors;
    for (const ActorScore& actor : actors) {
        const double n_real = actor.metrics.at("points_real");
        if (n_real < double(kMinRealPoints) || actor.is_discovered || is_person_or_cyclist(actor.category))
            continue;
        errors.push_back(std::abs(actor.metrics.at("points") / n_real - 1.0));
    }
    return errors.empty() ? std::nullopt : std::optional(compute_median(std::move(errors)));
}

}  // namespace relidar
