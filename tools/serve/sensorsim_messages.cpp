// SPDX-License-Identifier: Apache-2.0
#include "sensorsim_messages.hpp"

#include <algorithm>
#include <cmath>

#include <relidar/log/sensor_files.hpp>
#include <relidar/scene/labels.hpp>

#include "geometry_messages.hpp"
#include "refusal.hpp"

namespace relidar::serve {
namespace {

constexpr double kMicrosecond_s = 1e-6;
constexpr std::uint64_t kLongestFrame_us = 60'000'000;

struct LidarTypeSensor {
    sensorsim::LidarType type;
    const char* name;
    double period_s;  ///< Time of one turn of the sensor in seconds, as in find_sensor().
};
constexpr LidarTypeSensor kLidarTypes[] = {{sensorsim::PANDAR128, "Pandar128", 0.1},
                                           {sensorsim::AT128, "AT128", 0.1}};

const LidarTypeSensor& sensor_of_type(sensorsim::LidarType lidar_type) {
    const auto match = std::ranges::find(kLidarTypes, lidar_type, &LidarTypeSensor::type);
    if (match == std::end(kLidarTypes))
        reject_field("lidar.lidar_type", fmt::format("{}", int(lidar_type)),
                     "0 (PANDAR128), 1 (AT128) or 2 (OTHER)");
    return *match;
}

/// Writes a pose in the order that the client expects. With translation_first, the
/// translation is R^-1 t, because R (p + R^-1 t) = R p + t.
void write_pose(Pose pose, PoseTransformOrder order, sensorsim::Pose& message) {
    if (order == PoseTransformOrder::translation_first)
        pose.translation = glm::inverse(pose.rotation) * pose.translation;
    serve::write_pose(pose, message);
}

/// Writes a track with times in microseconds, which cannot be negative.
void write_track(const PoseTrack& track, PoseTransformOrder order, sensorsim::Trajectory& message) {
    for (std::size_t i = 0; i < track.pose.size(); ++i) {
        if (!(track.time_s[i] >= 0.0))
            refuse(Code::FAILED_PRECONDITION,
                   "cannot write a trajectory: found the time {} s, but messages have no negative times",
                   track.time_s[i]);
        sensorsim::PoseAtTime& pose = *message.add_poses();
        write_pose(track.pose[i], order, *pose.mutable_pose());
        pose.set_timestamp_us(std::uint64_t(std::llround(track.time_s[i] / kMicrosecond_s)));
    }
}

}  // namespace

/// Returns the requested sensor: a LiDAR of the log (type OTHER), or a built-in sensor.
/// Stretches its firing times, so that a scan takes as long as the requested interval.
SensorPtr SensorsimReader::find_or_make_sensor(const sensorsim::LidarRenderRequest& message,
                                               std::size_t scene) {
    const sensorsim::LidarType type = message.lidar().lidar_type();
    const std::string& id = message.lidar().logical_id();
    const bool is_of_log = type == sensorsim::OTHER;
    const std::vector<Lidar>& lidars = outlines_[scene].log.lidars;
    if (is_of_log && id.empty() && lidars.size() > 1)
        reject_field("lidar.logical_id", "no name, although lidar_type is OTHER",
                     fmt::format("the name of one of the log's {} LiDARs", lidars.size()));
    const int lidar = reader_.find_lidar(scene, id, "lidar.logical_id");
    const std::string name = is_of_log ? "native" : sensor_of_type(type).name;
    const std::uint64_t frame_us = message.frame_end_us() - message.frame_start_us();
    // Key of the stretched sensor. All scenes share the built-in sensors.
    const std::string key = fmt::format("{} {} {} {}", is_of_log ? scene : 0, lidar, name, frame_us);
    if (auto sensor = sensors_.find_cached(key)) return sensor;
    SimulatedSensor sensor = find_known_sensor(name, outlines_[scene], lidar);
    if (count_rays(sensor) == 0)
        reject_field("lidar.logical_id", quote_client_text(id) + ", a LiDAR whose beams are unknown",
                     "another LiDAR of the log, or lidar_type set to PANDAR128 or AT128");
    const double unstretched_s =
        is_of_log ? lidars[std::size_t(lidar)].sweep_period_s() : sensor_of_type(type).period_s;
    const double scan_s = double(frame_us) * kMicrosecond_s;
    const float stretch = unstretched_s > 0.0 ? float(scan_s / unstretched_s) : 1.0f;
    for (float& time_s : sensor.rays.time_offset_s) time_s *= stretch;
    return sensors_.add_sensor(key, std::move(sensor));
}

/// Reads a pose in the order that the client uses (PoseTransformOrder).
Pose SensorsimReader::read_pose(const sensorsim::Pose& message, const std::string& field) const {
    if (!message.has_translation() || !message.has_rotation())
        reject_field(field,
                     message.has_translation() ? "a pose without rotation" : "a pose without translation",
                     "both");
    Pose pose = serve::read_pose(message, field);
    // R (p + t) = R p + R t
    if (order_ == PoseTransformOrder::translation_first) pose.translation = pose.rotation * pose.translation;
    return pose;
}

/// Converts the poses at the start and end of the interval to a track in the world frame
/// of the dataset. An interval without duration has one pose.
PoseTrack SensorsimReader::read_track(const sensorsim::PosePair& message, const SensorsimTimeFrame& frame,
                                      const std::string& field) const {
    if (!message.has_start() || !message.has_end())
        reject_field(field, message.has_start() ? "no pose at the end" : "no pose at the start", "both");
    Pose start = read_pose(message.start(), field + ".start"), end = read_pose(message.end(), field + ".end");
    start.translation += frame.world_offset_m;
    end.translation += frame.world_offset_m;
    if (frame.end_s > frame.start_s) return {{frame.start_s, frame.end_s}, {start, end}};
    if (start.translation != end.translation || start.rotation != end.rotation)
        reject_field(field, "two different poses in a frame without duration",
                     "equal poses at start and end, or a frame_end_us greater than frame_start_us");
    return {{frame.start_s}, {start}};
}

/// Reads a request for a scan and checks all fields. Message times are in microseconds.
RenderRequest SensorsimReader::read_request(const sensorsim::LidarRenderRequest& message) {
    const std::uint64_t start_us = message.frame_start_us(), end_us = message.frame_end_us();
    if (end_us < start_us || end_us - start_us > kLongestFrame_us)
        reject_field("frame_end_us", fmt::format("{} with frame_start_us {}", end_us, start_us),
                     fmt::format("a time from 0 to {} microseconds after frame_start_us", kLongestFrame_us));
    RenderRequest scan;
    scan.scene = find_scene(message.scene_id());
    const SensorsimTimeFrame frame{checked_number(double(start_us) * kMicrosecond_s, "frame_start_us"),
                                   checked_number(double(end_us) * kMicrosecond_s, "frame_end_us"),
                                   outlines_[scan.scene].log.world_offset_m};
    scan.sensor = find_or_make_sensor(message, scan.scene);

    // The time of a scan is the middle of its sweep.
    scan.request.time_s = 0.5 * (frame.start_s + frame.end_s);
    scan.request.dataset_from_sensor = read_track(message.sensor_pose(), frame, "sensor_pose");
    scan.points_at_s = frame.end_s;
    std::vector<RequestedActor> actors;
    for (int i = 0; i < message.dynamic_objects_size(); ++i) {
        const sensorsim::DynamicObject& object = message.dynamic_objects(i);
        const std::string field = fmt::format("dynamic_objects[{}]", i);
        actors.push_back(
            {field + ".track_id", object.track_id(), read_track(object.pose(), frame, field + ".pose")});
    }
    reader_.set_visible(actors, scan);
    return scan;
}

/// Writes the points as numbers and as bytes. Both fields have the same values, and a
/// client may read either of them.
void write_points(const LidarPoints& points, sensorsim::LidarRenderReturn& message) {
    message.set_count(std::uint32_t(points.size()));
    const auto write_both = [&](const auto& values, std::string& bytes,
                                google::protobuf::RepeatedField<float>& numbers) {
        bytes.assign(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(values[0]));
        numbers.Resize(int(bytes.size() / sizeof(float)), 0.0f);
        std::memcpy(numbers.mutable_data(), bytes.data(), bytes.size());
    };
    write_both(points.position_m, *message.mutable_xyz_buffer(), *message.mutable_xyz());
    write_both(points.intensity, *message.mutable_intensity_buffer(), *message.mutable_intensities());
}

/// Writes the tracks of all actors of a run that have a box.
void write_actors(const Run& run, PoseTransformOrder order, sensorsim::DynamicObjectTracks& message) {
    for (const std::string& name : run_actor_names(run)) {
        const BoxTrack* box = find_box(run.log, name);
        if (!box) continue;
        sensorsim::DynamicObjectTrack& object = *message.add_dynamic_objects();
        object.set_id(name);
        object.set_semantic_class(name_of(class_of(*box)));
        write_vector(box->size_m, *object.mutable_object_size());
        // Leaves out poses before 0 s, because the message format has no negative times.
        const PoseTrack& track = box->world_from_box;
        PoseTrack written;
        for (std::size_t i = 0; i < track.pose.size(); ++i) {
            if (!(track.time_s[i] >= 0.0)) continue;
            written.time_s.push_back(track.time_s[i]);
            written.pose.push_back(track.pose[i]);
        }
        write_track(written, order, *object.mutable_trajectory());
    }
}

void write_paths(const Run& run, PoseTransformOrder order, sensorsim::AvailableTrajectories& message) {
    write_track(run.log.world_from_vehicle, order, *message.add_trajectories()->mutable_trajectory());
    for (std::size_t i = 0; i < run.log.lidars.size(); ++i)
        write_track(run.log.lidar_track(int(i)), order, *message.add_trajectories()->mutable_trajectory());
}

}  // namespace relidar::serve
