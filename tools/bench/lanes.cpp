// SPDX-License-Identifier: Apache-2.0
// relidar_bench_lanes scores a trained synthetic street in lanes that nobody drove. It
// renders scans in the middle between two frames, from a sensor that is shifted to both
// sides, and compares them with rays that are cast into the exact street. Moving objects
// are scored apart, and again without the surfaces that no training scan has seen.
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/simulate/render.hpp>

#include "street_of.hpp"

namespace {

using namespace relidar;

constexpr double kSeen_m = 0.1;  // distance from the nearest training return
/// What is scored: standing or moving objects, with or without unseen surfaces.
struct ScoredPart {
    const char* name;
    bool of_actors, only_seen;
};
constexpr ScoredPart kParts[] = {{.name = "static", .of_actors = false, .only_seen = false},
                                 {.name = "actors", .of_actors = true, .only_seen = false},
                                 {.name = "static, seen", .of_actors = false, .only_seen = true},
                                 {.name = "actors, seen", .of_actors = true, .only_seen = true}};

/// A scan from a shifted sensor.
struct LaneScan {
    Frame frame;
    std::vector<bool> actors;  ///< rays that end in a moving box
    std::vector<bool> seen;    ///< rays that end within 0.1 m of a training return

    std::vector<glm::dvec3> list_points(bool of_actors, bool only_seen) const {
        std::vector<glm::dvec3> points;
        for (std::size_t ray = 0; ray < actors.size(); ++ray)
            if (frame.scan.range_m[ray] > 0.0f && actors[ray] == of_actors && (seen[ray] || !only_seen))
                points.emplace_back(frame.scan.return_point(ray));
        return points;
    }
};

/// Returns of all training scans, in the world frame and in the frame of each moving box.
/// The key is the identifier of the box, or empty.
class TrainingReturns {
public:
    /// @param run  has the scans of its training frames
    explicit TrainingReturns(const Run& run) : log_(run.log), moving_(log_.boxes) {
        std::erase_if(moving_, [](const BoxTrack& box) { return !box.is_moving(); });
        for (const int position : run.split.train) {
            const Frame& frame = log_.frames[std::size_t(position)];
            for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
                if (frame.scan.range_m[ray] > 0.0f) add_to(points_, locate_return(log_, frame, ray));
        }
    }
    /// Marks the rays that end in a moving box or near a training return. A return in a
    /// box is compared with training returns in the frame of this box, because it moves.
    /// @param frame  has a scan of the sensor, shifted by `offset`
    LaneScan classify_rays(Frame frame, const Pose& offset) const {
        const PoseTrack track = mount_track(log_.lidar_track(frame.lidar), offset);
        const std::size_t n_rays = frame.scan.range_m.size();
        LaneScan lane{std::move(frame), std::vector<bool>(n_rays), std::vector<bool>(n_rays)};
        // Ends of the rays and indices of these rays, by the key of their cloud.
        std::map<std::string, std::vector<glm::dvec3>> ends;
        std::map<std::string, std::vector<std::size_t>> rays;
        for (std::size_t ray = 0; ray < n_rays; ++ray) {
            const Scan& scan = lane.frame.scan;
            if (!(scan.range_m[ray] > 0.0f)) continue;
            const WorldRay w = make_world_ray(track, lane.frame.time_s, scan.rays, ray, log_.rolling_shutter);
            const double t_s =
                lane.frame.time_s + (log_.rolling_shutter ? double(scan.rays.time_offset_s[ray]) : 0.0);
            const std::string box =
                add_to(ends, {w.origin_m + double(scan.range_m[ray]) * w.direction, w.direction, t_s, 0.0f});
            rays[box].push_back(ray);
            lane.actors[ray] = !box.empty();
        }
        for (const auto& [box, queries] : ends) {
            if (!points_.contains(box)) continue;
            const std::vector<double> distances = nearest_distances_m(queries, points_.at(box));
            for (std::size_t i = 0; i < queries.size(); ++i) lane.seen[rays[box][i]] = distances[i] < kSeen_m;
        }
        return lane;
    }

private:
    /// Adds a point to the cloud of the moving box around it, in the frame of this box,
    /// or to the cloud "" of the world. Returns the key of the cloud.
    std::string add_to(std::map<std::string, std::vector<glm::dvec3>>& clouds, const WorldReturn& end) const {
        for (const BoxTrack& box : moving_)
            if (box.is_observed(end.time_s) && box.contains_point(end.point_m, end.time_s, 0.0)) {
                clouds[box.id].push_back(inverse(box.world_from_box.pose_at(end.time_s)) * end.point_m);
                return box.id;
            }
        clouds[""].push_back(end.point_m);
        return "";
    }

    const Log& log_;
    std::vector<BoxTrack> moving_;
    std::map<std::string, std::vector<glm::dvec3>> points_;
};

/// Scores of the moving objects or of everything else, over several scans.
struct LaneScore {
    /// Range errors, distances from simulated points to the nearest exact point, and from
    /// exact points to the nearest simulated point.
    std::vector<double> errors_m, to_exact_m, to_simulated_m;
    std::size_t n_rays = 0, n_right = 0;  ///< right: returns or drops like the exact ray

    /// @param only_seen  only points at surfaces of the training scans are compared, with
    /// all points of the other scan
    void add_scans(const LaneScan& exact, const LaneScan& simulated, bool of_actors, bool only_seen) {
        for (std::size_t ray = 0; ray < exact.actors.size(); ++ray) {
            const double exact_m = exact.frame.scan.range_m[ray],
                         simulated_m = simulated.frame.scan.range_m[ray];
            const bool returns = exact_m > 0.0;
            if (exact.actors[ray] != of_actors || (only_seen && returns && !exact.seen[ray])) continue;
            ++n_rays;
            n_right += returns == (simulated_m > 0.0);
            if (returns && simulated_m > 0.0) errors_m.push_back(std::abs(simulated_m - exact_m));
        }
        const auto add_distances = [&](std::vector<double>& sum, const LaneScan& from, const LaneScan& to) {
            const std::vector<glm::dvec3> targets = to.list_points(of_actors, false);
            if (targets.empty()) return;
            const std::vector<double> distances =
                nearest_distances_m(from.list_points(of_actors, only_seen), targets);
            sum.insert(sum.end(), distances.begin(), distances.end());
        };
        add_distances(to_exact_m, simulated, exact);
        add_distances(to_simulated_m, exact, simulated);
    }
    double chamfer_m() const { return mean_of(to_exact_m) + mean_of(to_simulated_m); }
    double compute_f_score(double threshold_m) const {
        const double precision = share_below(to_exact_m, threshold_m),
                     recall = share_below(to_simulated_m, threshold_m);
        return 2.0 * precision * recall / std::max(precision + recall, 1e-12);
    }
    double median_error_m() {
        const auto middle = errors_m.begin() + std::ptrdiff_t(errors_m.size() / 2);
        std::nth_element(errors_m.begin(), middle, errors_m.end());
        return *middle;
    }

private:
    static double mean_of(const std::vector<double>& v) {
        return std::accumulate(v.begin(), v.end(), 0.0) / double(v.size());
    }
    static double share_below(const std::vector<double>& v, double limit) {
        return double(std::ranges::count_if(v, [&](double d) { return d < limit; })) / double(v.size());
    }
};

using ScoresOfParts = std::array<LaneScore, std::size(kParts)>;

/// Returns the exact ranges half a sweep after a frame, because this time is farthest
/// from the training poses. Casts the rays of the frame's LiDAR into the street.
/// @param offset  pose of the shifted sensor in the frame of the LiDAR
/// @return no value after the last pose of the log
std::optional<Frame> cast_exact_scan(const Run& run, const StreetOptions& street, const Frame& frame,
                                     const Pose& offset) {
    const Lidar& lidar = run.log.lidar_of(frame);
    Frame exact = strip_scan(frame);
    exact.time_s += 0.5 * lidar.sweep_period_s();
    if (!run.log.world_from_vehicle.contains_time(exact.time_s)) return {};
    exact.scan = cast_street_rays(street, make_lidar_rays(lidar, exact.time_s),
                                  mount_track(run.log.lidar_track(frame.lidar), offset), exact.time_s);
    return exact;
}

/// Renders scans of the first LiDAR from a shifted pose, compares them with exact scans
/// of the street, and adds them to the scores.
void score_lane(ScanRenderer& renderer, const Run& run, const StreetOptions& street,
                const TrainingReturns& training, const Pose& offset, ScoresOfParts& scores) {
    const SimulatedSensor sensor = make_sensor(run.config, run.log, 0);
    for (const Frame& frame : run.log.frames) {
        if (frame.lidar != 0) continue;
        std::optional<Frame> exact = cast_exact_scan(run, street, frame, offset);
        if (!exact) continue;
        limit_ranges(exact->scan, sensor.limits);
        // The simulated scan has the rays of the exact scan, but the rendered ranges.
        const RenderedScan scan = renderer.render(sensor, exact->time_s, offset);
        const std::vector<float>& points_m = point_ranges(scan, run.config);
        Frame simulated = *exact;
        for (std::size_t ray = 0; ray < points_m.size(); ++ray)
            simulated.scan.range_m[ray] =
                is_ray_returned(scan.image.drop_prob[ray], points_m[ray]) ? points_m[ray] : 0.0f;
        const LaneScan exact_scan = training.classify_rays(std::move(*exact), offset),
                       simulated_scan = training.classify_rays(std::move(simulated), offset);
        for (std::size_t i = 0; i < scores.size(); ++i)
            scores[i].add_scans(exact_scan, simulated_scan, kParts[i].of_actors, kParts[i].only_seen);
    }
}

/// Prints the scores of a sensor that is shifted by up to 3 m to either side.
void print_lane_table(const std::string& run_folder) {
    // LiDAR-RT compares squared distances with 0.05 m2, which is a distance of 22 cm.
    const double kFineThreshold_m = 0.05, kLidarRtThreshold_m = std::sqrt(0.05);
    Run run = load_run(run_folder);
    run.config = with_max_range(std::move(run.config), run.log);
    run.config.sensor.grid = "native";  // the rays that are cast into the street
    const StreetOptions street = read_street(run);
    copy_scans(run, run.split.train, load_log(run.config));  // for TrainingReturns
    const TrainingReturns training(run);
    Device device(apply_environment({}));
    ScanRenderer renderer(device, run);
    fmt::print(
        "| metres to the left | part | rays | median range error | Chamfer | F-score, 5 cm | F-score, 22 cm "
        "| correct drops |\n|--:|---|--:|--:|--:|--:|--:|--:|\n");
    for (const double left_m : {0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0}) {
        const Pose offset{{1, 0, 0, 0}, {0.0, left_m, 0.0}};
        ScoresOfParts scores;
        score_lane(renderer, run, street, training, offset, scores);
        for (std::size_t i = 0; i < scores.size(); ++i) {
            LaneScore& score = scores[i];
            if (score.errors_m.empty()) continue;
            fmt::print("| {:+g} | {} | {} | {:.4f} m | {:.4f} m | {:.3f} | {:.3f} | {:.1f} % |\n", left_m,
                       kParts[i].name, score.n_rays, score.median_error_m(), score.chamfer_m(),
                       score.compute_f_score(kFineThreshold_m), score.compute_f_score(kLidarRtThreshold_m),
                       100.0 * double(score.n_right) / double(score.n_rays));
        }
    }
}

}  // namespace

int main(int argc, char** argv) { return relidar::run_on_argument(argc, argv, print_lane_table); }
