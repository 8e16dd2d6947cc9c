// SPDX-License-Identifier: Apache-2.0
// Compares the measured and simulated points of people and cyclists in the frames of
// their boxes.
#include "score/evaluation/people.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include <relidar/scene/scene.hpp>
#include <relidar/score/evaluation.hpp>

namespace relidar {
namespace {

constexpr double kMargin_m = 0.1, kSilhouette_m = 0.3;
// Height above the bottom of a box. Points below this height belong to the ground.
constexpr double kFloor_m = 0.15;
constexpr double kNear_m = 0.03;
constexpr double kSweep_m = 2.0;  // Maximum distance that a box moves within one sweep.
// Minimum number of real points of a person. People with fewer points are not scored.
constexpr std::size_t kFewest = 10;

/// A box at the time of a scan. Converts points from the sensor frame to the box frame.
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
    /// Converts a point to the frame of the box. Uses the poses of sensor and box at the
    /// time at which the head faces the point. Returns nothing if the point is far from
    /// the box.
    std::optional<glm::dvec3> in_box(const glm::dvec3& in_sensor) const {
        if (glm::distance(in_sensor, centre_m) > 0.5 * glm::length(box.size_m) + kSilhouette_m + kSweep_m)
            return std::nullopt;
        const double t_s = facing_time(sequence, in_sensor, seen);
        return inverse(box.world_from_box.at(t_s)) * (sensor(t_s) * in_sensor);
    }
    bool holds(const std::optional<glm::dvec3>& p, double margin_m) const {
        const glm::dvec3 half = 0.5 * box.size_m;
        return p && std::abs(p->x) <= half.x + margin_m && std::abs(p->y) <= half.y + margin_m &&
               p->z <= half.z + margin_m && p->z >= kFloor_m - half.z;
    }
};

glm::dvec3 point_of(const RangeImage& image, std::size_t ray, float range_m) {
    return glm::dvec3(image.origin[ray] + range_m * image.direction[ray]);
}

double mean_of(const std::vector<double>& values) {
    double sum = 0.0;
    for (const double v : values) sum += v;
    return sum / double(std::max<std::size_t>(values.size(), 1));
}

}  // namespace

PeoplePoints people_points(const RangeImage& rendered, const std::vector<float>& points_m,
                           const RangeImage& real, const Sequence& sequence, const SweepMoment& seen,
                           const BoxTrack& box) {
    const InScan in_scan(sequence, seen, box);
    PeoplePoints result;
    for (std::size_t i = 0; i < points_m.size(); ++i) {
        std::optional<glm::dvec3> measured, simulated;
        if (real.range_m[i] > 0.0f) measured = in_scan.in_box(point_of(real, i, real.range_m[i]));
        if (returned(rendered.drop_prob[i], points_m[i]))
            simulated = in_scan.in_box(point_of(rendered, i, points_m[i]));
        if (in_scan.holds(measured, kMargin_m)) result.real_m.push_back(*measured);
        if (in_scan.holds(simulated, kMargin_m)) result.simulated_m.push_back(*simulated);
        const bool in_real = in_scan.holds(measured, kSilhouette_m),
                   in_simulated = in_scan.holds(simulated, kSilhouette_m);
        result.n_both += in_real && in_simulated;
        result.n_missed += in_real && !in_simulated;
        result.n_false += in_simulated && !in_real;
    }
    return result;
}

MetricRow people_scores(const RangeImage& rendered, const std::vector<float>& points_m,
                        const RangeImage& real, const Sequence& sequence, const SweepMoment& seen) {
    std::vector<double> chamfer_m, near;
    double both = 0.0, either = 0.0;
    for (const BoxTrack& box : sequence.boxes) {
        const ObjectKind kind = object_kind(box.category);
        if ((kind != ObjectKind::person && kind != ObjectKind::cyclist) || !box.moves() ||
            !box.present(seen.time_s))
            continue;
        const PeoplePoints p = people_points(rendered, points_m, real, sequence, seen, box);
        if (p.real_m.size() < kFewest) continue;
        both += double(p.n_both);
        either += double(p.n_both) + 0.5 * double(p.n_missed + p.n_false);
        if (p.simulated_m.empty()) continue;  // Without simulated points, only people_f1 can be computed.
        const std::vector<double> to_real = nearest_distances(p.simulated_m, p.real_m);
        chamfer_m.push_back(mean_of(to_real) + mean_of(nearest_distances(p.real_m, p.simulated_m)));
        for (const double d : to_real) near.push_back(d <= kNear_m ? 1.0 : 0.0);
    }
    MetricRow scores;
    if (either > 0.0) scores["actors/people_f1"] = both / either;
    if (!chamfer_m.empty())
        scores["actors/people_cd_m"] = mean_of(chamfer_m), scores["actors/people_3cm"] = mean_of(near);
    return scores;
}

}  // namespace relidar
