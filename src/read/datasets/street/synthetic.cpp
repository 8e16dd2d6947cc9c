// SPDX-License-Identifier: Apache-2.0
// Generates synthetic logs. A spinning LiDAR, or several sensors of any type, drive
// through the street. Each ray is cast at its firing time. A hit is measured as
//   s = reflectance * cosine * min(1, (25 m / range)^2)
//   intensity = reflectance * (0.3 + 0.7 cosine) * (1 - range / 160 m)
//   P(drop) = 1 / (1 + (s / s0)^3),  s0 = 0.01
// A hash of seed, frame and ray decides which rays are dropped, so that the log is
// reproducible.

#include <cmath>
#include <limits>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/log/sensor_files.hpp>
#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "base/random.hpp"
#include "read/datasets/street/cone_echoes.hpp"
#include "read/datasets/street/street.hpp"

namespace relidar {
namespace {

using street::StreetHit;

constexpr double kMaxRange_m = 80.0;
// A ray needs 44 bytes, so this limits a log to 9 GB.
constexpr double kMostRays = 2e8;

void require_valid_synthetic_options(const SyntheticOptions& options) {
    const auto in_range = [](const char* name, double value, double low, double high) {
        if (value >= low && value <= high) return;
        fail<UsageError>("synthetic street: {} is {}, expected {} to {}", name, value, low, high);
    };
    in_range("n_frames", options.n_frames, 1, 10000);
    in_range("rows", options.rows, 2, 256);
    in_range("columns", options.columns, 8, 8192);
    in_range("range_noise_m", options.range_noise_m, 0.0, 1.0);
    in_range("speed_mps", options.speed_mps, 0.0, 40.0);
    if (options.gait && !options.people)
        throw UsageError(
            "synthetic street: found gait = true with people = false, expected people = true if gait is "
            "true");
}

SpinningSensor make_default_synthetic_sensor(const SyntheticOptions& options) {
    SpinningSensor sensor;
    sensor.name = "synthetic";
    const double spacing_deg = 28.0 / (options.rows - 1);
    for (int i = 0; i < options.rows; ++i) {  // the spacing is slightly irregular, as for a real sensor
        const double elevation_deg = 3.0 - spacing_deg * (i + 0.2 * std::sin(2.1 * i));
        sensor.beams.push_back({.elevation_rad = elevation_deg * kPi / 180.0});
    }
    sensor.columns = options.columns;
    sensor.first_azimuth_rad = kPi - kPi / options.columns;
    sensor.max_range_m = kMaxRange_m;
    return sensor;
}

double compute_drop_probability(const StreetHit& hit) {
    const double echo = hit.reflectance * hit.cosine * std::min(1.0, std::pow(25.0 / hit.range_m, 2));
    return 1.0 / (1.0 + std::pow(echo / 0.01, 3));
}

double compute_echo_intensity(const StreetHit& hit) {
    return glm::clamp(hit.reflectance * (0.3 + 0.7 * hit.cosine) * (1.0 - hit.range_m / 160.0), 0.0, 1.0);
}

/// Skips shapes that no ray of one sweep can reach.
street::SyntheticStreet select_shapes_in_reach_of_sweep(const street::SyntheticStreet& full_street,
                                                        const glm::dvec3& sensor_position_m, double time_s) {
    // how far the sensor and the cars can move during a sweep
    constexpr double kSweep_m = 20.0;
    street::SyntheticStreet nearby_street;
    for (const street::StreetShape& shape : full_street.shapes)
        if (glm::distance(shape.centre, sensor_position_m) <=
            kMaxRange_m + kSweep_m + 2.0 * glm::length(shape.half))
            nearby_street.shapes.push_back(shape);
    for (const street::MovingStreetActor& car : full_street.cars)
        if (glm::distance(car.compute_world_from_box(time_s).translation, sensor_position_m) <=
            kMaxRange_m + kSweep_m + glm::length(car.size_m))
            nearby_street.cars.push_back(car);
    return nearby_street;
}

/// Casts every ray at its firing time. Calls on_hit(ray, hit) for each hit.
template <class Receive>
void cast_rays_at_firing_times(const street::SyntheticStreet& full_street,
                               const glm::dvec3& world_origin_in_street_m, const PoseTrack& sensor_track,
                               double scan_time_s, const RayTable& rays, const Receive& on_hit) {
    const street::StreetCaster street(select_shapes_in_reach_of_sweep(
        full_street, sensor_track.interpolate_pose(scan_time_s).translation + world_origin_in_street_m,
        scan_time_s));
    const std::size_t columns = rays.rows > 1 ? std::size_t(rays.columns) : 1;
    // Rays of a column usually have the same time.
    std::vector<street::MovingActorPoses> actor_poses_by_column(columns);
    for (std::size_t ray = 0; ray < rays.size(); ++ray) {
        WorldRay in_street = make_world_ray(sensor_track, scan_time_s, rays, ray, true);
        in_street.origin_m += world_origin_in_street_m;
        const double t_s = scan_time_s + double(rays.time_offset_s[ray]);
        if (const std::optional<StreetHit> hit =
                street.find_first_hit(in_street, t_s, kMaxRange_m, actor_poses_by_column[ray % columns]))
            on_hit(ray, *hit);
    }
}

Scan make_empty_scan(const RayTable& rays) {
    return {.rays = rays,
            .range_m = ScanArray<float>(rays.size(), 0.0f),
            .intensity = ScanArray<float>(rays.size(), 0.0f),
            .classes = ScanArray<SurfaceClass>(rays.size(), SurfaceClass::unknown)};
}

/// the sensor position in the middle frame
glm::dvec3 compute_world_origin_in_street_m(const SyntheticOptions& options) {
    return street::compute_sensor_pose(options, street::compute_frame_time_s(options.n_frames / 2))
        .translation;
}

/// Rays with a drop probability above 0.5 are dropped.
Scan cast_noise_free_scan_with_one_return(const street::SyntheticStreet& street,
                                          const glm::dvec3& world_origin_in_street_m, const RayTable& rays,
                                          const PoseTrack& sensor_track, double scan_time_s) {
    Scan scan = make_empty_scan(rays);
    cast_rays_at_firing_times(street, world_origin_in_street_m, sensor_track, scan_time_s, rays,
                              [&](std::size_t ray, const StreetHit& hit) {
                                  if (compute_drop_probability(hit) > 0.5) return;
                                  scan.range_m[ray] = float(hit.range_m);
                                  scan.intensity[ray] = float(compute_echo_intensity(hit));
                                  scan.classes[ray] = hit.surface;
                              });
    return scan;
}

Scan cast_noise_free_scan_with_two_returns(const street::SyntheticStreet& street,
                                           const glm::dvec3& world_origin_in_street_m, const RayTable& rays,
                                           const PoseTrack& sensor_track, double scan_time_s) {
    if (!(rays.find_max_divergence_rad() > 0.0))
        throw UsageError(
            "synthetic street: several returns need beams with a divergence, because an ideal ray has only "
            "one return");
    return street::combine_cone_returns(
        rays, cast_noise_free_scan_with_one_return(street, world_origin_in_street_m,
                                                   street::split_rays_into_cone_rays(rays), sensor_track,
                                                   scan_time_s));
}

std::uint64_t compute_frame_seed(const SyntheticOptions& options, const LidarFrame& frame) {
    const std::uint64_t seed = hash_integer_pair(options.seed, std::uint64_t(frame.index));
    return frame.lidar == 0 ? seed : hash_integer_pair(seed, std::uint64_t(frame.lidar));
}

void add_range_noise(Scan& scan, std::uint64_t seed, double noise_stddev_m) {
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        Random random(hash_integer_pair(seed, i));
        const auto spread = [&](float& range_m) {
            if (range_m > 0.0f)
                range_m =
                    float(std::max(double(range_m) + noise_stddev_m * random.sample_standard_normal(), 0.01));
        };
        spread(scan.range_m[i]);
        for (AdditionalReturns& f : scan.second_returns) spread(f.range_m[i]);
    }
}

Scan simulate_noisy_scan_with_two_returns(const SyntheticOptions& options,
                                          const street::SyntheticStreet& street,
                                          const LidarSequence& sequence, const RayTable& rays,
                                          const LidarFrame& frame) {
    Scan scan = cast_noise_free_scan_with_two_returns(
        street, sequence.world_offset_m, rays, sequence.get_world_from_sensor(frame.lidar), frame.time_s);
    add_range_noise(scan, compute_frame_seed(options, frame), options.range_noise_m);
    return scan;
}

Scan simulate_noisy_scan_with_one_return(const SyntheticOptions& options,
                                         const street::SyntheticStreet& street, const LidarSequence& sequence,
                                         const RayTable& rays, const LidarFrame& frame) {
    Scan scan = make_empty_scan(rays);
    const std::uint64_t seed = compute_frame_seed(options, frame);
    const PoseTrack track = sequence.get_world_from_sensor(frame.lidar);
    cast_rays_at_firing_times(
        street, sequence.world_offset_m, track, frame.time_s, rays,
        [&](std::size_t ray, const StreetHit& hit) {
            Random random(hash_integer_pair(seed, ray));
            if (random.sample_uniform_number() < compute_drop_probability(hit)) return;
            const double range = hit.range_m + options.range_noise_m * random.sample_standard_normal();
            scan.range_m[ray] = float(std::max(range, 0.01));
            scan.intensity[ray] = float(
                glm::clamp(compute_echo_intensity(hit) + 0.01 * random.sample_standard_normal(), 0.0, 1.0));
            scan.classes[ray] = hit.surface;
        });
    return scan;
}

std::vector<BoxTrack> make_car_box_tracks(const street::SyntheticStreet& street,
                                          const std::vector<double>& frame_times_s) {
    std::vector<BoxLabel> labels;
    for (const double time_s : frame_times_s)
        for (std::size_t c = 0; c < street.cars.size(); ++c) {
            const street::MovingStreetActor& car = street.cars[c];
            labels.push_back(
                {std::to_string(c), car.category, car.size_m, time_s, car.compute_world_from_box(time_s)});
        }
    return build_tracks(labels);
}

std::vector<MountedSensor> read_rig_or_default_sensor(const SyntheticOptions& options) {
    if (options.rig.empty()) {
        const SpinningSensor default_sensor = make_default_synthetic_sensor(options);
        return {{"", {default_sensor.name, "", default_sensor.range_limits(), default_sensor}, {}, 1}};
    }
    std::optional<std::vector<MountedSensor>> rig = read_sensor_rig(options.rig);
    if (!rig)
        fail<UsageError>("synthetic street: rig: {} contains no rig, expected JSON with the key \"sensors\"",
                         options.rig);
    return std::move(*rig);
}

}  // namespace

LidarSequence make_synthetic_frames(const SyntheticOptions& options, int begin_frame, int end_frame) {
    require_valid_synthetic_options(options);
    const std::vector<MountedSensor> rig = read_rig_or_default_sensor(options);
    std::vector<RayTable> rays;  // of the first scan
    double n_rays = 0.0;
    for (const MountedSensor& mounted : rig)
        n_rays += double(rays.emplace_back(make_rays(mounted.sensor)).size());
    if (double(end_frame - begin_frame) * n_rays > kMostRays)
        fail<UsageError>(
            "synthetic street: {} frames with {} rays have {:.3g} rays in total, expected at most {:.3g}; "
            "use fewer frames",
            end_frame - begin_frame, n_rays, double(end_frame - begin_frame) * n_rays, kMostRays);
    const street::SyntheticStreet street = street::make_street(options);
    LidarSequence sequence;
    sequence.name = fmt::format("synthetic street {}", options.seed);
    sequence.source = "synthetic";
    sequence.conventions =
        "Sensor frame: x forward, y left, z up, in metres. Times are seconds after frame 0. At the time of a "
        "frame, the head faces forward. Poses are exact, and each ray is cast at its firing time.";
    sequence.lidars.clear();
    for (const MountedSensor& mounted : rig) {
        Lidar lidar{mounted.name, {}, mounted.rig_from_sensor};
        set_nominal_sensor(lidar, mounted.sensor);
        const RangeLimits limits = intersect_range_limits(mounted.sensor.limits, {0.0, kMaxRange_m});
        lidar.sensor.min_range_m = limits.min_m;
        lidar.sensor.max_range_m = limits.max_m;
        sequence.lidars.push_back(std::move(lidar));
    }
    for (int frame = begin_frame; frame < end_frame; ++frame)
        for (std::size_t l = 0; l < rig.size(); ++l)
            add_frame(sequence, frame, street::compute_frame_time_s(frame),
                      street::compute_sensor_pose(options, street::compute_frame_time_s(frame)), int(l));
    sequence.boxes = make_car_box_tracks(street, sequence.world_from_vehicle.time_s);
    move_world_origin_of_log(sequence, compute_world_origin_in_street_m(options));
    parallel_for(int(sequence.frames.size()), [&](int index) {
        LidarFrame& frame = sequence.frames[std::size_t(index)];
        const std::size_t l = std::size_t(frame.lidar);
        const bool changes = summarise_scan_pattern(rig[l].sensor.pattern).has_rays_by_time;
        const RayTable table = changes ? make_rays(rig[l].sensor, frame.time_s) : rays[l];
        frame.scan = rig[l].returns == 2
                         ? simulate_noisy_scan_with_two_returns(options, street, sequence, table, frame)
                         : simulate_noisy_scan_with_one_return(options, street, sequence, table, frame);
    });
    return sequence;
}

LidarSequence make_synthetic_street(const SyntheticOptions& options) {
    return make_synthetic_frames(options, 0, options.n_frames);
}

namespace {

void replace_moving_cars(street::SyntheticStreet& street, const std::vector<SyntheticCar>& edited_cars,
                         const glm::dvec3& world_origin_in_street_m, double time_s) {
    const std::vector<street::MovingStreetActor> original_cars = std::move(street.cars);
    street.cars.clear();
    for (const SyntheticCar& car : edited_cars) {
        if (car.shapes_of >= original_cars.size())
            fail(
                "cannot cast rays into the edited street: track {} refers to car {} of the street, but the "
                "street has only {} cars, which are numbered from 0; expected the street that the run was "
                "trained with",
                car.track.id, car.shapes_of, original_cars.size());
        if (!car.track.is_observed_at_time(time_s)) continue;
        street::MovingStreetActor& moved = street.cars.emplace_back(original_cars[car.shapes_of]);
        moved.track = car.track.world_from_box;
        for (Pose& pose : moved.track.pose) pose.translation += world_origin_in_street_m;
    }
}

}  // namespace

Scan cast_rays_into_synthetic_street(const SyntheticOptions& options, const RayTable& rays,
                                     const PoseTrack& world_from_sensor, double time_s) {
    require_valid_synthetic_options(options);
    return cast_noise_free_scan_with_one_return(street::make_street(options),
                                                compute_world_origin_in_street_m(options), rays,
                                                world_from_sensor, time_s);
}

Scan cast_beams_into_synthetic_street(const SyntheticOptions& options, const RayTable& rays,
                                      const PoseTrack& world_from_sensor, double time_s) {
    require_valid_synthetic_options(options);
    return cast_noise_free_scan_with_two_returns(street::make_street(options),
                                                 compute_world_origin_in_street_m(options), rays,
                                                 world_from_sensor, time_s);
}

Scan cast_rays_into_synthetic_street(const SyntheticOptions& options, const std::vector<SyntheticCar>& cars,
                                     const RayTable& rays, const PoseTrack& world_from_sensor,
                                     double time_s) {
    require_valid_synthetic_options(options);
    street::SyntheticStreet street = street::make_street(options);
    replace_moving_cars(street, cars, compute_world_origin_in_street_m(options), time_s);
    return cast_noise_free_scan_with_one_return(street, compute_world_origin_in_street_m(options), rays,
                                                world_from_sensor, time_s);
}

}  // namespace relidar
