// SPDX-License-Identifier: Apache-2.0
// Compares the measured and the simulated points of moving boxes. The points are compared
// in the frames of the boxes.
#include "score/evaluation/actor_scores.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include <relidar/scene/scene.hpp>
#include <relidar/score/evaluation.hpp>
#include "base/median.hpp"
#include "score/evaluation/tails.hpp"

namespace relidar {
namespace {

constexpr double kMargin_m = 0.1, kSilhouette_m = 0.3;
// Points less than this height above the bottom of a box are ignored, because they are on
// the ground.
constexpr double kFloor_m = 0.15;
constexpr double kNear_m = 0.03, kLargeError_m = 0.3;
constexpr double kSweep_m = 2.0;  // Maximum distance that a box moves within one sweep.
// Persons with fewer real points are not scored.
constexpr std::size_t kFewest = 10;

/// A box in a scan. Converts points from the sensor frame to the frame of the box, at the
/// time when the LiDAR measured them.
struct InScan {
    const Sequence& sequence;
    const SweepMoment& seen;
    const BoxTrack& box;
    glm::dvec3 centre_m;  ///< centre of the box at the scan's time, sensor frame

    InScan(const Sequence& s, const SweepMoment& at, const BoxTrack& b)
        : sequence(s),
          seen(at),
          box(b),
          centre_m(inverse(sensor(at.time_s)) * b.world_from_box.at(at.time_s).translation) {}

    Pose sensor(double t_s) const {
        return sequence.world_from_vehicle.at(t_s,
                                              sequence.lidars[std::size_t(seen.lidar)].vehicle_from_sensor);
    }
    /// Converts a point to the frame of the box, with the poses at the time when the
    /// LiDAR's head faces the point. Returns nothing if the point is far from the box.
    std::optional<glm::dvec3> to_box_frame(const glm::dvec3& in_sensor) const {
        if (glm::distance(in_sensor, centre_m) > 0.5 * glm::length(box.size_m) + kSilhouette_m + kSweep_m)
            return std::nullopt;
        const double t_s = compute_facing_time(sequence, in_sensor, seen);
        return inverse(box.world_from_box.at(t_s)) * (sensor(t_s) * in_sensor);
    }
    bool holds(const std::optional<glm::dvec3>& point, double margin_m) const {
        const glm::dvec3 half = 0.5 * box.size_m;
        return point && std::abs(point->x) <= half.x + margin_m && std::abs(point->y) <= half.y + margin_m &&
               point->z <= half.z + margin_m && point->z >= kFloor_m - half.z;
    }
};

glm::dvec3 compute_ray_end_point(const RangeImage& image, std::size_t ray, float range_m) {
    return glm::dvec3(image.origin[ray] + range_m * image.direction[ray]);
}

double compute_mean(const std::vector<double>& values) {
    double sum = 0.0;
    for (const double v : values) sum += v;
    return sum / double(std::max<std::size_t>(values.size(), 1));
}

/// Adds the median, the bias and the fraction of large values of range errors to a row of
/// metrics. Adds nothing if there are no errors.
/// @param prefix  prefix of the metric names
void add_range_errors(MetricRow& row, const std::string& prefix, const std::vector<double>& error_m) {
    if (error_m.empty()) return;
    std::vector<double> absolute_m, large;
    for (const double error : error_m) {
        absolute_m.push_back(std::abs(error));
        large.push_back(std::abs(error) > kLargeError_m ? 1.0 : 0.0);
    }
    row[prefix + "medae_m"] = compute_median(absolute_m);
    row[prefix + "bias_m"] = compute_median(error_m);
    row[prefix + "above_30cm"] = compute_mean(large);
}

/// Errors of a group of boxes: either all people and cyclists, or all other labelled
/// boxes.
struct GroupErrors {
    std::vector<double> range_error_m, chamfer_m, near;
    double both = 0.0, either = 0.0;

    void add(const BoxPoints& points) {
        range_error_m.insert(range_error_m.end(), points.range_error_m.begin(), points.range_error_m.end());
        both += double(points.n_both);
        either += double(points.n_both) + 0.5 * double(points.n_missed + points.n_false);
        if (points.simulated_m.empty()) return;  // without simulated points, only F1 can be computed
        const std::vector<double> to_real = compute_nearest_distances(points.simulated_m, points.real_m);
        chamfer_m.push_back(compute_mean(to_real) +
                            compute_mean(compute_nearest_distances(points.real_m, points.simulated_m)));
        for (const double d : to_real) near.push_back(d <= kNear_m ? 1.0 : 0.0);
    }
    void add_scores(MetricRow& row, const std::string& prefix) const {
        add_range_errors(row, prefix, range_error_m);
        if (either > 0.0) row[prefix + "f1"] = both / either;
        if (chamfer_m.empty()) return;
        row[prefix + "cd_m"] = compute_mean(chamfer_m);
        row[prefix + "3cm"] = compute_mean(near);
    }
};

bool is_person(const BoxTrack& box) {
    const ObjectKind kind = parse_object_kind(box.category);
    return kind == ObjectKind::person || kind == ObjectKind::cyclist;
}

MetricRow score_box(const BoxPoints& points) {
    MetricRow row{{"points", double(points.simulated_m.size())},
                  {"points_real", double(points.real_m.size())}};
    add_range_errors(row, "range_", points.range_error_m);
    const double either = double(points.n_both) + 0.5 * double(points.n_missed + points.n_false);
    if (either > 0.0) row["f1"] = double(points.n_both) / either;
    return row;
}

}  // namespace

BoxPoints collect_points_in_box(const RangeImage& rendered, const std::vector<float>& points_m,
                                const RangeImage& real, const Sequence& sequence, const SweepMoment& sweep,
                                const BoxTrack& box) {
    const InScan in_scan(sequence, sweep, box);
    BoxPoints result;
    for (std::size_t i = 0; i < points_m.size(); ++i) {
        std::optional<glm::dvec3> measured, simulated;
        const bool returns = is_returned(rendered.drop_prob[i], points_m[i]);
        if (real.range_m[i] > 0.0f)
            measured = in_scan.to_box_frame(compute_ray_end_point(real, i, real.range_m[i]));
        if (returns) simulated = in_scan.to_box_frame(compute_ray_end_point(rendered, i, points_m[i]));
        if (in_scan.holds(measured, kMargin_m)) {
            result.real_m.push_back(*measured);
            if (returns) result.range_error_m.push_back(double(points_m[i]) - double(real.range_m[i]));
        }
        if (in_scan.holds(simulated, kMargin_m)) result.simulated_m.push_back(*simulated);
        const bool in_real = in_scan.holds(measured, kSilhouette_m),
                   in_simulated = in_scan.holds(simulated, kSilhouette_m);
        result.n_both += in_real && in_simulated;
        result.n_missed += in_real && !in_simulated;
        result.n_false += in_simulated && !in_real;
    }
    return result;
}

ActorScores compute_actor_scores(const RangeImage& rendered, const std::vector<float>& points_m,
                                 const RangeImage& real, const Sequence& sequence, const SweepMoment& sweep) {
    ActorScores scores;
    const TailCounts tails = count_points_in_tails(rendered, points_m, sequence, sweep),
                     real_tails = count_points_in_tails(real, real.range_m, sequence, sweep);
    if (tails.n_of_box.empty()) return scores;
    scores.metrics["actors/tail_share"] = tails.share;
    scores.metrics["actors/tail_share_real"] = real_tails.share;
    GroupErrors people, vehicles;
    for (const BoxTrack& box : sequence.boxes) {
        if (!tails.n_of_box.contains(box.id)) continue;  // a box that does not move has no tail
        BoxPoints p;
        if (box.is_present(sweep.time_s))
            p = collect_points_in_box(rendered, points_m, real, sequence, sweep, box);
        scores.actors.push_back({box.id, box.category, score_box(p)});
        scores.actors.back().metrics["tail"] = double(tails.n_of_box.at(box.id));
        scores.actors.back().metrics["tail_real"] = double(real_tails.n_of_box.at(box.id));
        if (p.real_m.size() < kFewest || box.category == kDiscoveredCategory) continue;
        (is_person(box) ? people : vehicles).add(p);
    }
    people.add_scores(scores.metrics, "actors/people_");
    vehicles.add_scores(scores.metrics, "actors/vehicles_");
    return scores;
}

std::vector<ActorScore> average_over_frames(const std::vector<std::vector<ActorScore>>& frames) {
    struct Sums {
        std::string category;
        MetricRow counts, weighted, weight;
    };
    std::map<std::string, Sums> sums;
    for (const std::vector<ActorScore>& frame : frames)
        for (const ActorScore& actor : frame) {
            Sums& s = sums[actor.track];
            s.category = actor.category;
            for (const auto& [name, value] : actor.metrics) {
                const bool is_count = name.starts_with("points") || name.starts_with("tail");
                const double weight = actor.metrics.at("points_real");
                if (is_count) s.counts[name] += value;
                else s.weighted[name] += weight * value, s.weight[name] += weight;
            }
        }
    std::vector<ActorScore> actors;
    for (const auto& [track, s] : sums) {
        actors.push_back({track, s.category, s.counts});
        for (const auto& [name, value] : s.weighted)
            if (s.weight.at(name) > 0.0) actors.back().metrics[name] = value / s.weight.at(name);
    }
    const auto badness = [](const ActorScore& actor) {
        const auto it = actor.metrics.find("range_above_30cm");
        return it == actor.metrics.end() ? -1.0 : it->second;
    };
    std::ranges::stable_sort(actors, std::greater{}, badness);
    return actors;
}

}  // namespace relidar
