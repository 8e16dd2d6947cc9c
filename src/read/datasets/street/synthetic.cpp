// SPDX-License-Identifier: Apache-2.0
// Generates synthetic logs. A spinning LiDAR, or several sensors of any type, drive
// through the street. Each ray is cast at its firing time. A hit is measured as
//   s = reflectance * cosine * min(1, (25 m / range)^2)
//   intensity = reflectance * (0.3 + 0.7 cosine) * (1 - range / 160 m)
//   P(drop) = 1 / (1 + (s / s0)^3),  s0 = 0.01
// A hash of seed, frame and ray decides which rays are dropped, so that the log is
// reproducible.

#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "base/random.hpp"
#include "read/datasets/street/street.hpp"

namespace relidar {
namespace {

using street::StreetHit;

constexpr double kMaxRange_m = 80.0;
constexpr double kMinNoisyRange_m = 0.01;  // Noise must not make a range 0, which is a dropped ray.
// A ray needs 44 bytes, so this limits a log to 9 GB.
constexpr double kMostRays = 2e8;

/// Limits the size of a street, because a file of a few bytes could request all memory.
void check_options(const StreetOptions& options) {
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

/// Makes a LiDAR with beams at +3 to about -25 degrees. Column 0 faces backward.
SpinningSensor make_default_sensor(const StreetOptions& options) {
    SpinningSensor sensor;
    sensor.name = "synthetic";
    const double spacing_deg = 28.0 / (options.rows - 1);
    for (int i = 0; i < options.rows; ++i) {  // the sine makes it irregular, as in a real sensor
        const double elevation_deg = 3.0 - spacing_deg * (i + 0.2 * std::sin(2.1 * i));
        sensor.beams.push_back({.elevation_rad = elevation_deg * kPi / 180.0});
    }
    sensor.columns = options.columns;
    sensor.first_azimuth_rad = kPi - kPi / options.columns;  // pi minus half a column
    sensor.max_range_m = kMaxRange_m;
    return sensor;
}

/// Returns the probability that a hit is too weak for the receiver. The formula is at the
/// top of this file.
double drop_chance(const StreetHit& hit) {
    const double echo = hit.reflectance * hit.cosine * std::min(1.0, std::pow(25.0 / hit.range_m, 2));
    return 1.0 / (1.0 + std::pow(echo / 0.01, 3));
}

double echo_intensity(const StreetHit& hit) {
    return glm::clamp(hit.reflectance * (0.3 + 0.7 * hit.cosine) * (1.0 - hit.range_m / 160.0), 0.0, 1.0);
}

/// Returns only the shapes that the rays of one sweep can reach. This makes ray casting
/// faster. Compares the centres of shapes, so the limits contain their sizes.
street::SyntheticStreet crop_street(const street::SyntheticStreet& full_street,
                                    const glm::dvec3& sensor_position_m, double time_s) {
    // Upper limit of the distances that the sensor and the cars move during a sweep.
    constexpr double kMaxSweepMotion_m = 20.0;
    street::SyntheticStreet nearby_street;
    for (const street::StreetShape& shape : full_street.shapes)
        if (glm::distance(shape.centre, sensor_position_m) <=
            kMaxRange_m + kMaxSweepMotion_m + 2.0 * glm::length(shape.half))
            nearby_street.shapes.push_back(shape);
    for (const street::MovingStreetActor& car : full_street.cars)
        if (glm::distance(car.world_from_box_at(time_s).translation, sensor_position_m) <=
            kMaxRange_m + kMaxSweepMotion_m + glm::length(car.size_m))
            nearby_street.cars.push_back(car);
    return nearby_street;
}

/// Casts every ray of a scan at its firing time. Calls on_hit(ray, hit) for each ray that
/// hits a surface.
/// @param world_origin_in_street_m  origin of the log's world in the street frame
/// @param rays  rays in the sensor frame, with times relative to `scan_time_s`
template <class Receive>
void cast_rays(const street::SyntheticStreet& full_street, const glm::dvec3& world_origin_in_street_m,
               const PoseTrack& sensor_track, double scan_time_s, const RayTable& rays,
               const Receive& on_hit) {
    const glm::dvec3 sensor_m = sensor_track.pose_at(scan_time_s).translation + world_origin_in_street_m;
    const street::StreetCaster street(crop_street(full_street, sensor_m, scan_time_s));
    const std::size_t columns = rays.rows > 1 ? std::size_t(rays.columns) : 1;
    // One cache of car poses per column, because rays of a column usually have the same
    // time.
    std::vector<street::ActorPoses> actor_poses_by_column(columns);
    constexpr bool kRollingShutter = true;  // each ray starts at the pose of its firing time
    for (std::size_t ray = 0; ray < rays.size(); ++ray) {
        WorldRay in_street = make_world_ray(sensor_track, scan_time_s, rays, ray, kRollingShutter);
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
glm::dvec3 world_origin_m(const StreetOptions& options) {
    return street::sensor_pose_at(options, street::frame_time_of_s(options.n_frames / 2)).translation;
}

/// Returns an exact scan without noise. Rays with a drop probability above 0.5 are
/// dropped.
Scan cast_scan(const street::SyntheticStreet& street, const glm::dvec3& world_origin_in_street_m,
               const RayTable& rays, const PoseTrack& sensor_track, double scan_time_s) {
    Scan scan = make_empty_scan(rays);
    cast_rays(street, world_origin_in_street_m, sensor_track, scan_time_s, rays,
              [&](std::size_t ray, const StreetHit& hit) {
                  if (drop_chance(hit) > 0.5) return;
                  scan.range_m[ray] = float(hit.range_m);
                  scan.intensity[ray] = float(echo_intensity(hit));
                  scan.classes[ray] = hit.surface;
              });
    return scan;
}

/// Returns an exact scan with two returns per ray. Casts thin rays inside the cone of
/// each beam, and combines their hits.
Scan cast_dual_scan(const street::SyntheticStreet& street, const glm::dvec3& world_origin_in_street_m,
                    const RayTable& rays, const PoseTrack& sensor_track, double scan_time_s,
                    double max_range_m) {
    if (!(rays.max_divergence_rad() > 0.0))
        throw UsageError(
            "synthetic street: several returns need beams with a divergence, because an ideal ray has only "
            "one return");
    const Scan cone_scan =
        cast_scan(street, world_origin_in_street_m, street::make_cone_rays(rays), sensor_track, scan_time_s);
    return street::combine_cone(rays, cone_scan, max_range_m);
}

std::uint64_t seed_of(const StreetOptions& options, const Frame& frame) {
    const std::uint64_t seed = hash_pair(options.seed, std::uint64_t(frame.index));
    return frame.lidar == 0 ? seed : hash_pair(seed, std::uint64_t(frame.lidar));
}

/// Adds normal noise to all ranges of a scan. Each ray has its own random numbers, so its
/// noise does not depend on other rays.
void add_range_noise(Scan& scan, std::uint64_t seed, double noise_stddev_m) {
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        Random random(hash_pair(seed, i));
        const auto add_noise = [&](float& range_m) {
            if (range_m > 0.0f)
                range_m = float(
                    std::max(double(range_m) + noise_stddev_m * random.sample_normal(), kMinNoisyRange_m));
        };
        add_noise(scan.range_m[i]);
        for (AdditionalReturns& further : scan.second_returns) add_noise(further.range_m[i]);
    }
}

/// Returns a scan with two returns per ray and noisy ranges.
Scan simulate_dual_scan(const StreetOptions& options, const street::SyntheticStreet& street, const Log& log,
                        const RayTable& rays, const Frame& frame) {
    const SpinningSensor& sensor = log.lidar_of(frame).sensor;
    Scan scan = cast_dual_scan(street, log.world_offset_m, rays, log.lidar_track(frame.lidar), frame.time_s,
                               nominal_max_range_m(sensor.name).value_or(sensor.max_range_m));
    add_range_noise(scan, seed_of(options, frame), options.range_noise_m);
    return scan;
}

/// Returns a scan with noisy ranges and intensities. The random numbers depend only on
/// seed, frame and ray, so threads can generate frames in any order.
Scan simulate_scan(const StreetOptions& options, const street::SyntheticStreet& street, const Log& log,
                   const RayTable& rays, const Frame& frame) {
    constexpr double kIntensityNoise = 0.01;
    Scan scan = make_empty_scan(rays);
    const std::uint64_t seed = seed_of(options, frame);
    const PoseTrack track = log.lidar_track(frame.lidar);
    cast_rays(street, log.world_offset_m, track, frame.time_s, rays,
              [&](std::size_t ray, const StreetHit& hit) {
                  Random random(hash_pair(seed, ray));
                  if (random.sample_uniform() < drop_chance(hit)) return;
                  const double range = hit.range_m + options.range_noise_m * random.sample_normal();
                  scan.range_m[ray] = float(std::max(range, kMinNoisyRange_m));
                  const double intensity = echo_intensity(hit) + kIntensityNoise * random.sample_normal();
                  scan.intensity[ray] = float(glm::clamp(intensity, 0.0, 1.0));
                  scan.classes[ray] = hit.surface;
              });
    return scan;
}

/// Returns the box of each moving actor at all times. Its id is the number of the actor.
std::vector<BoxTrack> make_car_tracks(const street::SyntheticStreet& street,
                                      const std::vector<double>& times_s) {
    std::vector<BoxLabel> labels;
    for (const double time_s : times_s)
        for (std::size_t c = 0; c < street.cars.size(); ++c) {
            const street::MovingStreetActor& car = street.cars[c];
            labels.push_back(
                {std::to_string(c), car.category, car.size_m, time_s, car.world_from_box_at(time_s)});
        }
    return build_tracks(labels);
}

/// Returns the sensors in the rig file (a list of mounted sensors). Without a rig file,
/// returns the default sensor.
std::vector<MountedSensor> read_street_rig(const StreetOptions& options) {
    if (options.rig.empty()) {
        const SpinningSensor spinning = make_default_sensor(options);
        const SensorModel sensor{spinning.name, "", spinning.range_limits(), spinning};
        return {{.name = "", .sensor = sensor, .rig_from_sensor = {}, .returns = 1}};
    }
    std::optional<std::vector<MountedSensor>> rig = read_sensor_rig(options.rig);
    if (!rig)
        fail<UsageError>("synthetic street: rig: {} contains no rig, expected JSON with the key \"sensors\"",
                         options.rig);
    return std::move(*rig);
}

/// Returns the LiDARs of a rig. Rays are cast up to kMaxRange_m, where their range ends.
std::vector<Lidar> make_rig_lidars(const std::vector<MountedSensor>& rig) {
    std::vector<Lidar> lidars;
    for (const MountedSensor& mounted : rig) {
        Lidar& lidar = lidars.emplace_back(Lidar{mounted.name, {}, mounted.rig_from_sensor});
        set_sensor(lidar, mounted.sensor);
        const RangeLimits limits = intersect(mounted.sensor.limits, {0.0, kMaxRange_m});
        lidar.sensor.min_range_m = limits.min_m;
        lidar.sensor.max_range_m = limits.max_m;
    }
    return lidars;
}

}  // namespace

Log make_frames(const StreetOptions& options, int begin_frame, int end_frame) {
    check_options(options);
    const std::vector<MountedSensor> rig = read_street_rig(options);
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
    Log log;
    log.name = fmt::format("synthetic street {}", options.seed);
    log.source = "synthetic";
    log.conventions =
        "Sensor frame: x forward, y left, z up, in metres. Times are seconds after frame 0. At the time of a "
        "frame, the head faces forward. Poses are exact, and each ray is cast at its firing time.";
    log.lidars = make_rig_lidars(rig);
    for (int frame = begin_frame; frame < end_frame; ++frame)
        for (std::size_t l = 0; l < rig.size(); ++l)
            add_frame(log, frame, street::frame_time_of_s(frame),
                      street::sensor_pose_at(options, street::frame_time_of_s(frame)), int(l));
    log.boxes = make_car_tracks(street, log.world_from_vehicle.time_s);
    centre_log(log, world_origin_m(options));
    parallel_for(int(log.frames.size()), [&](int index) {
        Frame& frame = log.frames[std::size_t(index)];
        const std::size_t l = std::size_t(frame.lidar);
        // Some patterns change from sweep to sweep, so their rays depend on the time of
        // the frame.
        const bool changes = summarise_pattern(rig[l].sensor.pattern).has_rays_by_time;
        const RayTable table = changes ? make_rays(rig[l].sensor, frame.time_s) : rays[l];
        frame.scan = rig[l].returns == 2 ? simulate_dual_scan(options, street, log, table, frame)
                                         : simulate_scan(options, street, log, table, frame);
    });
    return log;
}

Log make_street_log(const StreetOptions& options) { return make_frames(options, 0, options.n_frames); }

namespace {

/// Replaces all cars of the street by the cars of an edit that exist at `time_s`. Their
/// tracks are in the world frame and are moved to the frame of the street.
void replace_cars(street::SyntheticStreet& street, const std::vector<SyntheticCar>& edited_cars,
                  const glm::dvec3& world_origin_in_street_m, double time_s) {
    const std::vector<street::MovingStreetActor> original_cars = std::move(street.cars);
    street.cars.clear();
    for (const SyntheticCar& car : edited_cars) {
        // A car of an edit has the shapes of one of the original cars.
        const std::size_t original = car.shapes_of;
        if (original >= original_cars.size())
            fail(
                "cannot cast rays into the edited street: track {} refers to car {} of the street, but the "
                "street has only {} cars, which are numbered from 0; expected the street that the run was "
                "trained with",
                car.track.id, original, original_cars.size());
        if (!car.track.is_observed(time_s)) continue;
        street::MovingStreetActor& moved = street.cars.emplace_back(original_cars[original]);
        moved.track = car.track.world_from_box;
        for (Pose& pose : moved.track.pose) pose.translation += world_origin_in_street_m;
    }
}

}  // namespace

Scan cast_street_rays(const StreetOptions& options, const RayTable& rays, const PoseTrack& world_from_sensor,
                      double time_s) {
    check_options(options);
    return cast_scan(street::make_street(options), world_origin_m(options), rays, world_from_sensor, time_s);
}

Scan cast_street_beams(const StreetOptions& options, const RayTable& rays, const PoseTrack& world_from_sensor,
                       double time_s, double max_range_m) {
    check_options(options);
    return cast_dual_scan(street::make_street(options), world_origin_m(options), rays, world_from_sensor,
                          time_s, max_range_m);
}

Scan cast_street_rays(const StreetOptions& options, const std::vector<SyntheticCar>& cars,
                      const RayTable& rays, const PoseTrack& world_from_sensor, double time_s) {
    check_options(options);
    street::SyntheticStreet street = street::make_street(options);
    replace_cars(street, cars, world_origin_m(options), time_s);
    return cast_scan(street, world_origin_m(options), rays, world_from_sensor, time_s);
}

}  // namespace relidar
