// SPDX-License-Identifier: Apache-2.0
// Defines the data that a recording stores for one moment, from the scans of all sensors.
// These types do not depend on the message format.
#pragma once

#include <cmath>
#include <glm/glm.hpp>
#include <optional>
#include <span>

#include <relidar/log/georeference.hpp>
#include <relidar/read/points.hpp>
#include <relidar/simulate/scan_files.hpp>
#include "simulate/scan_files/seen_actors.hpp"

namespace relidar::scan_files {

inline constexpr const char* kWorldFrame = "world";
inline constexpr const char* kVehicleFrame = "base_link";
/// Frame of points in the world whose coordinates are too large for floats.
inline constexpr const char* kMapFrame = "map";

struct RecordedSensor {
    std::string topic, frame_id;
    Pose vehicle_from_sensor;
};
struct StaticTransform {
    std::string parent, child;
    Pose parent_from_child;
};
struct RecordedRig {
    std::vector<RecordedSensor> sensors;
    bool world = false;
    glm::dvec3 points_origin_m{0.0};    ///< of points in the world
    std::optional<GeoConverter> earth;  ///< empty if the place of the world is unknown

    bool has_map_frame() const { return world && points_origin_m != glm::dvec3(0.0); }
    std::string cloud_frame(std::size_t sensor) const;
    std::vector<StaticTransform> static_transforms() const;
};

/// State of the vehicle, or of the box of an actor.
struct ObjectState {
    std::uint64_t time_ns;
    Pose world_from_object;
    Velocity velocity;
};
/// Position of the vehicle on the earth.
struct RecordedFix {
    std::uint64_t time_ns;
    GeodeticPosition position;
};
struct RecordedActor : ActorInScan {
    /// The box of a moving actor matches its points only when the sensor points at it.
    ObjectState faced;
    ObjectState at_stamp;  ///< state at RecordedSweep::first_ns
};

struct SweepInterval {
    double first_s, last_s;
};
/// Returns the times of the first and of the last ray of several scans.
SweepInterval sweep_interval(std::span<const RenderedScan> scans);
inline std::int64_t to_stamp_ns(double time_s, std::int64_t time_shift_ns) {
    return time_shift_ns + std::llround(1e9 * time_s);
}
/// @return sweep_interval(scans)
/// @throws DataError if a time is before 1970 or after 2038
SweepInterval check_times(std::span<const RenderedScan> scans, std::int64_t time_shift_ns);

struct RecordedCloud {
    std::uint64_t stamp_ns;  ///< firing time of the first ray
    LidarPoints points;
};

struct RecordedSweep {
    std::uint64_t first_ns, last_ns;  ///< firing times of the first and last ray of all sensors
    /// of the vehicle; ascending, and later than the poses of earlier scans
    std::vector<ObjectState> poses = {};
    /// [sensors] motion-compensated points are in the sensor's frame at the stamp
    std::vector<RecordedCloud> clouds = {};
    std::vector<RecordedActor> actors = {};  ///< each actor once
    std::vector<RecordedFix> fixes = {};     ///< one, at the first pose, if RecordedRig::earth is known
};

class SweepRecorder {
public:
    explicit SweepRecorder(std::vector<ScanOutputOptions> sensors)
        : sensors_(std::move(sensors)), earth_(recorded_rig().earth) {}
    RecordedRig recorded_rig() const;
    /// Computes everything that a recording stores for the scans of one moment.
    /// @param scans one scan per sensor, all with the same time
    /// @return refers to actors of this recorder, which must outlive it
    /// @throws DataError if times decrease, or if the file format cannot represent them
    RecordedSweep record(std::span<const RenderedScan> scans);

private:
    std::vector<ScanOutputOptions> sensors_;
    std::optional<GeoConverter> earth_;  ///< RecordedRig::earth
    std::optional<double> last_scan_s_;  ///< time of the previous scan in the log
    std::optional<std::uint64_t> last_pose_ns_;

    std::uint64_t to_stamp_ns(double time_s) const;
    ObjectState state_at(const std::function<Pose(double)>& world_from_object, double time_s) const;
    std::vector<ObjectState> vehicle_poses(const RenderedScan& scan, std::vector<double> times_s);
    RecordedCloud make_cloud(const RenderedScan& scan, const ScanOutputOptions& format, double first_s) const;
    std::vector<RecordedActor> recorded_actors(const RenderedScan& scan, double cloud_time_s) const;
};

}  // namespace relidar::scan_files
