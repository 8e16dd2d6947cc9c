// SPDX-License-Identifier: Apache-2.0
// Writes rendered scans to files for other tools. Each file also stores the pose, the
// time, the sensor and the run, if the format has fields for them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <relidar/base/arrays.hpp>
#include <relidar/base/images.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/channels.hpp>
#include <relidar/log/log.hpp>
#include <relidar/log/own_vehicle.hpp>
#include <relidar/log/sensor.hpp>
#include <relidar/run/config.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar {

struct RangeImage;
struct RenderedScan;
struct Run;
struct SimulatedSensor;

/// Returns the names of all formats: the file extensions for single scans, and the
/// recordings `mcap`, `rosbag` and `pcap`.
std::vector<std::string> scan_formats();
/// Returns what the files of each format contain, for help texts.
std::string make_scan_format_help();
/// Returns true if one file stores all scans, so that only one process can write it.
bool is_recording(const std::string& format);

/// Coordinate frame of points, and of the rays in npz and exr files.
enum class PointCoordinateFrame { sensor, world };

struct PacketFormatOptions {
    std::optional<SpinningSensor> sensor;  ///< empty if the sensor does not spin
    std::string ouster_profile;            ///< packet format, as in PacketOptions
};

struct ScanOutputOptions {
    std::vector<std::string> formats{"npz"};  ///< names from scan_formats()
    PointCoordinateFrame frame = PointCoordinateFrame::sensor;
    /// Map of the points in ply, pcd and las files in the world frame; other formats do
    /// not use it. Empty: the points are in the dataset's world.
    std::optional<MapProjector> map = {};
    /// Only for points in the sensor frame. True: frame at the time of the scan. False:
    /// frame at each point's firing time.
    bool deskew = false;
    std::vector<std::string> instance_names;  ///< names by instance: "background" or the track
    /// Tracks of the rendered actors. Empty if everything was rendered.
    std::vector<std::string> only;
    /// Empty if the scan has expected values.
    std::optional<std::uint64_t> sample;
    Weather weather = {};
    std::string run;  ///< name of the run's folder
    std::string sensor;
    std::optional<Camera> camera = {};  ///< of scans that are pictures of a camera
    RangeLimits limits;
    /// Relative to the log's sensor, or to the poses of `trajectory`.
    Pose offset;
    /// For the frame of the vehicle in recordings.
    Pose vehicle_from_lidar;
    std::optional<OwnVehicle> vehicle = {};
    /// Height of base_link of `vehicle` above the ground, metres: the median over the
    /// scans. No value if the log has not observed the ground.
    std::optional<double> base_link_height_m = {};
    bool rolling_shutter = true;
    /// The names of the sensor's other topics begin with this name.
    std::string topic = "/lidar/points";
    std::string frame_id = "lidar";  ///< frame id of the sensor in recordings
    /// In relidar's world frame. Recordings store them as boxes.
    std::vector<BoxTrack> actors;
    /// list_standing() of the run. Their boxes are stored like those of actors.
    std::vector<BoxTrack> standing;
    glm::dvec3 world_offset_m{0.0};
    std::optional<Georeference> georeference = {};  ///< Log::georeference
    /// Name of the file with the poses of the sensor. If empty, the poses of the log's
    /// sensor are used.
    std::string trajectory;
    PacketFormatOptions packets;
    /// Added to times of the log in recordings and packets (time_shift_of()).
    std::int64_t time_shift_ns = 0;
    Config config;
};
/// Returns a time shift for ScanOutputOptions::time_shift_ns with which no stamp is
/// before 1970.
/// @param first_scan_s  time of the first scan that is written; default: the first frame
/// of the log
std::int64_t time_shift_of(const Run& run, const SimulatedSensor& sensor,
                           double first_scan_s = std::numeric_limits<double>::infinity());
/// Returns the default format for scans of a run: npz files with rays in the sensor
/// frame, at the poses of the log's sensor.
ScanOutputOptions default_options(const Run& run, const SimulatedSensor& sensor);
/// Returns true if all points of a written scan share one coordinate frame: in the world
/// frame, with `deskew`, or without a rolling shutter. Otherwise each point is in the
/// sensor frame at its firing time.
bool has_common_frame(const ScanOutputOptions& options);
/// Returns the origin of points in the world frame in files of single precision (bin,
/// exr, recordings): world_offset_m, or 0 if floats have steps below 1 mm there.
glm::dvec3 points_origin_m(const ScanOutputOptions& options);
/// Sets the topic and the frame id of a sensor to /lidar/NAME/points, with
/// to_topic_name(), and NAME. An empty name gives /lidar/points and lidar.
void name_topics(ScanOutputOptions& options, const std::string& sensor_name);
/// Replaces characters that ROS does not allow in topic names by _.
std::string to_topic_name(const std::string& name);

/// Writes recordings: a file for each recording format, with all scans of a sensor or
/// of the sensors of a rig. A file gets its final name when it is finished.
///   mcap    scans.mcap, for Foxglove: foxglove.PointCloud of each sensor (x y z intensity
///           time instance ring return, channels), FrameTransforms on /tf and /tf_static,
///           SceneUpdate on /actors with a box for each actor
///   rosbag  rosbag.mcap, of ROS 2: sensor_msgs/PointCloud2 of each sensor (x y z intensity
///           time ring return, channels) and in the sensor frame TOPIC_xyzircaedt with
///           Autoware's point type; /tf, /tf_static, /clock, /odom; boxes on /actors
///           (vision_msgs/Detection3DArray) and /actors_autoware (TrackedObjects)
///   pcap    packets.pcap, or packets_NAME.pcap for each sensor of a rig (PacketEncoder);
///           packets.csv or packets.json has the calibration for the driver
/// Transforms: world -> base_link (the log's vehicle), every 10 ms of a sweep and at
/// every pose of its path; base_link -> each sensor; for points in the world world -> map
/// if points_origin_m() is not 0. /fix has positions on the earth, if they are known.
///
/// Times: stamps are times of the log plus ScanOutputOptions::time_shift_ns. The stamp of
/// a cloud is the time of its first ray; times of points are relative to it. Points in
/// the sensor frame are converted to the world by the transforms at their own times, or
/// with ScanOutputOptions::deskew at the stamp. A box on /actors has the time at which
/// the sensor faces it; boxes on /actors_autoware have the time of the first ray of all
/// sensors, and velocities. Each message has all actors once, also of a rig. A scan is
/// logged at the time of its last ray, after the transforms that it needs.
class ScanRecordingsWriter {
public:
    /// Creates the recordings in an existing folder. Removes the files of an earlier
    /// rendering: list_scan_files().
    /// @param sensors  at least one; common settings are read from the first
    /// @throws UsageError if two topics or frames have the same name, if ROS does not
    /// allow a name, or if find_foreign_file() finds a file
    /// @throws DataError if a file cannot be written
    ScanRecordingsWriter(std::filesystem::path folder, std::vector<ScanOutputOptions> sensors);
    /// Appends the scans of a sweep to the recordings.
    /// @param scans  a scan for each sensor, all of the same sweep
    /// @throws DataError if times decrease or a file cannot store them
    void write_scans(std::span<const RenderedScan> scans);
    /// Gives the files their final names, and lists them in scans.json.
    void finish();
    /// Returns the names of the files. Calibration files of packets are listed after
    /// finish().
    std::vector<std::string> list_file_names() const;

private:
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

struct ScanTopic {
    std::string name, type;     ///< type: name of the Protobuf message
    std::string schema_base64;  ///< Protobuf FileDescriptorSet of the message, in base64.
};
struct ScanMessage {
    std::size_t topic;  ///< index in ScanMessageEncoder::list_topics()
    std::uint64_t time_ns;
    std::string bytes;
};

/// Converts scans to the messages of scans.mcap, so that a server can send them.
class ScanMessageEncoder {
public:
    explicit ScanMessageEncoder(std::vector<ScanOutputOptions> sensors);
    std::vector<ScanTopic> list_topics() const;
    /// Converts the scans of a sweep to messages in the order of their times.
    /// @param scans  a scan for each sensor, all of the same sweep
    /// @throws DataError if times decrease
    std::vector<ScanMessage> encode(std::span<const RenderedScan> scans);

private:
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

/// Writes the scans of a sensor to a folder one by one, and a summary file scans.json.
/// The files of a scan are FOLDER/frame_000123.<format>:
///   npz  range, median_range, intensity, drop_prob, weight, time, ring [rows,columns];
///        instance [rows,columns] int32, -1 if nothing was hit, -2 for the own vehicle;
///        instance_names [instances], the names of the instances;
///        directions, origin, points [rows,columns,3]; origin and points of the world are
///        float64;
///        with sensor.returns = 2: range_2, intensity_2 [rows,columns], 0 if there is no
///        second return, and in weather source_2;
///        each of RenderedScan::channels by its name, [rows,columns], or for vectors
///        [rows,columns,3];
///        unseen: RenderedScan::unseen_share, if it is known;
///        pose [4,4] world_from_sensor at time_s;
///        of a camera: picture, depth (draw_depth()) [rows,columns] and the matrix K [3,3];
///        time_s, frame_number, frame, deskewed, sensor, run, units
///   exr  the images as float channels, metadata as string attributes
///   png  range, intensity and drop probability as a single image, metadata as text; of a
///        camera: draw_camera(), and frame_000123_depth.png has draw_depth()
///   ply, pcd, las, bin
///        points of returned rays (drop_prob < 0.5), as write_ply() describes; ply and
///        pcd also have ring, time, instance, the scan's channels and, with second
///        returns, return (1 or 2); metadata as comments
/// Recordings (ScanRecordingsWriter) contain all scans and are completed after the last
/// scan.
class ScanFolderWriter {
public:
    /// Creates the folder if it does not exist. Removes the files of an earlier
    /// rendering.
    /// @throws UsageError for an unknown format
    /// @throws DataError if the folder cannot be written
    ScanFolderWriter(std::filesystem::path folder, ScanOutputOptions format);
    /// Opens a folder that another process has created for the same rendering.
    /// @throws UsageError for a recording, because only one process can write it
    /// @throws errors of the constructor
    static ScanFolderWriter join_folder(std::filesystem::path folder, ScanOutputOptions options);
    /// Writes the files of a scan.
    /// @throws DataError if a file cannot be written
    void write_scan(int frame_number, const RenderedScan& scan);
    /// Writes scans.json and finishes the recordings. Must be called after the last scan.
    void finish();
    const std::filesystem::path& path() const { return folder_; }
    /// Returns the entries of scans.json, as JSON without line breaks. set_entries() can
    /// add the entries of other processes.
    const std::vector<std::string>& entries() const { return entries_; }
    void set_entries(std::vector<std::string> entries) { entries_ = std::move(entries); }

private:
    ScanFolderWriter() = default;

    std::filesystem::path folder_;
    ScanOutputOptions format_;
    std::vector<std::string> entries_;
    std::vector<ChannelInfo> channels_;  ///< channels of the scans, in addition to the basic ones
    /// A shared pointer, so that a ScanFolderWriter can be moved. Null if another process
    /// has created the folder.
    std::shared_ptr<ScanRecordingsWriter> recordings_;
    std::shared_ptr<void> unfinished_marker_;  ///< its deleter removes the file of a rendering without scans

    void open_folder(std::filesystem::path folder, ScanOutputOptions format);
    void write_summary() const;
};

/// Returns the arrays of a scan's npz file, in the order of the file.
std::vector<NamedArray> scan_arrays(const RenderedScan& scan, int frame, const ScanOutputOptions& format);

/// Returns the files that an earlier rendering has written to a folder: those in its
/// scans.json, or all of an unfinished rendering. ScanFolderWriter would remove them.
std::vector<std::filesystem::path> list_scan_files(const std::filesystem::path& folder);
/// Returns a file that list_scan_files() does not list, although its name is a name of
/// rendered scans. Empty if there is none.
std::filesystem::path find_foreign_file(const std::filesystem::path& folder);

/// Draws the ranges in false colours, which depend on the square root of the range, so
/// that near objects have more contrast. The next two functions return gray pictures. In
/// all pictures, pixels without a return are dark gray.
Image draw_range(const RangeImage& image, double max_range_m);
Image draw_intensity(const RangeImage& image);
Image draw_drop(const RangeImage& image);
/// Draws range, intensity and drop probability below each other.
Image draw_scan(const RenderedScan& scan);
/// Returns the vertical factor for stack_images(). LiDAR images would otherwise look too
/// flat, because the angles between rows are larger than between columns.
int stretch_factor(const RangeImage& image);
/// Returns a mask [rows*columns]: 1 for pixels with a return, 0 for all others.
std::vector<float> return_mask(const RangeImage& image);

}  // namespace relidar
