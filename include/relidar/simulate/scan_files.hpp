// SPDX-License-Identifier: Apache-2.0
// Rendered scans as files other tools open, each with what its format can carry of where,
// when and by what it was made.
#pragma once

#include <cstdint>
#include <filesystem>
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
#include <relidar/log/sensor.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar {

struct RangeImage;
struct RenderedScan;
struct Run;
struct SensorChoice;

/// Names of the formats: extensions of a scan's files, and recordings of all scans, mcap
/// and rosbag.
std::vector<std::string> scan_formats();
/// Whether a format is one file of all scans, which one process writes.
bool is_recording(const std::string& format);

/// Frame of reference of points, and of the rays in npz and exr.
enum class PointFrame { sensor, world };

/// What is written, and what the files say of themselves.
struct ScanFormat {
    std::vector<std::string> formats{"npz"};  ///< of scan_formats()
    PointFrame frame = PointFrame::sensor;
    /// sensor frame: of the scan's reference time for all rays, instead of each ray's
    /// firing time
    bool deskew = false;
    std::vector<std::string> instance_names;  ///< "background" or the track, by instance
    std::vector<std::string> only;            ///< what was rendered alone; empty: everything
    std::optional<std::uint64_t> sample;      ///< seed of a sampled scan; none: the likeliest
    Weather weather = {};
    std::string run;  ///< its folder
    std::string sensor;
    RangeLimits limits;
    Pose offset;  ///< of the simulated sensor in the log's sensor frame, or in that of its trajectory
    Pose vehicle_from_lidar;  ///< where the log's sensor is mounted: recordings have the vehicle, too
    /// of the scans, see has_rolling_shutter(): rays are fired at their own times
    bool rolling_shutter = true;
    /// of the sensor's clouds in recordings; names of others of its topics begin with it
    std::string topic = "/lidar/points";
    std::string frame_id = "lidar";  ///< of the sensor in recordings
    std::vector<BoxTrack> actors;    ///< where they are: boxes of recordings; relidar's world
    glm::dvec3 world_offset_m{0.0};  ///< Sequence::world_offset_m
    std::string trajectory;          ///< file it was driven by; empty: it went along with the log's sensor
    Config config;
};
/// Of a run by a sensor where the log's own one was: npz, in the sensor's frame.
ScanFormat scan_format(const Run& run, const SensorChoice& sensor);
/// Whether all points of a scan are in one frame: that of the world, or the sensor's at
/// the scan's time (recordings: at the stamp), because they are brought there or because
/// all rays are fired at that time.
bool is_deskewed(const ScanFormat& format);
/// Gives a sensor the names that recordings have it by: topic /lidar/NAME/points, of
/// topic_word(NAME), and the frame NAME; of an empty name /lidar/points and lidar. @param
/// name  of the log's LiDAR or of a rig's sensor
void name_in_recordings(ScanFormat& format, const std::string& name);
/// A name as a word of a topic: what topics cannot have is _.
std::string topic_word(const std::string& name);

/// Scans of one sensor, or of those of a rig that scan together, in one file for each
/// kind that formats name, which appears when it is finished:
///   mcap    scans.mcap for Foxglove: foxglove.PointCloud (x y z intensity time instance ring return, channels) on each sensor's topic, /tf
///           and /tf_static foxglove.FrameTransforms, /actors foxglove.SceneUpdate with a box each
///   rosbag  rosbag.mcap, a bag of ROS 2: on each sensor's topic sensor_msgs/PointCloud2 (x y z intensity time ring, channels), on
///           TOPIC_xyzircaedt the same with Autoware's point type, in the sensor's frame alone; /tf, /tf_static, /odom nav_msgs/Odometry,
///           /clock; /actors vision_msgs/Detection3DArray, /actors_autoware autoware_perception_msgs/TrackedObjects
/// Frames are world -> base_link, the log's vehicle, on /tf, every 10 ms of a sweep and
/// wherever its path has a pose; and base_link -> each sensor on /tf_static. A cloud's
/// stamp is that of its first ray, times of points count from there. A point in the
/// sensor's frame at its own time comes to the world by the transforms of that time; with
/// ScanFormat::deskew by those of the stamp. Each box on /actors has the time at which
/// the sensor faces it, those on /actors_autoware that of the cloud, with velocities. A
/// scan is logged when its last ray is fired, behind the transforms that it needs.
class ScanRecordings {
public:
    /// Removes an earlier rendering from the folder, which is there.
    /// @param sensors  one at least; what all of them share is that of the first
    /// @throws UsageError for names that two topics or frames share, or that ROS does not
    /// take; DataError as write_atomically()
    ScanRecordings(std::filesystem::path folder, std::vector<ScanFormat> sensors);
    /// @param scans  one of each sensor, taken together @throws DataError for times that
    /// fall or that a file cannot have
    void write(std::span<const RenderedScan> scans);
    void finish();
    /// Of the files.
    std::vector<std::string> names() const;

private:
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

/// Scans of one sensor written one by one into a folder, and scans.json, which says what
/// they are. Files of one scan are FOLDER/frame_000123.<format>:
///   npz  range, median_range, intensity, drop_prob, weight, time, ring [rows,columns], instance [rows,columns] int32, -1 where nothing was
///        met, and instance_names [instances] its meaning, texts; directions, origin [rows,columns,3];
///        with sensor.returns = 2 range_2, intensity_2 [rows,columns], 0 where there is no second return, and in weather source_2;
///        each of RenderedScan::channels by its name, [rows,columns] or of vectors [rows,columns,3];
///        unseen, RenderedScan::unseen_share where it is known;
///        pose [4,4] world_from_sensor at time_s; time_s, frame_number, frame, deskewed, sensor, run, units
///   exr  the images as float channels, notes as string attributes
///   png  range, intensity, drop probability as one picture, notes as text
///   ply, pcd, bin  points of returned rays (drop_prob < 0.5); ply and pcd with ring, time and instance,
///        with second returns return, 1 or 2, and with the scan's channels, see write_ply(); notes as comments
/// and of all scans together, when the last one is written, the recordings: see
/// ScanRecordings.
class ScanFolder {
public:
    /// Makes the folder where it is missing, and removes an earlier rendering from it.
    /// @throws UsageError for an unknown format, naming the nearest; DataError where the
    /// folder cannot be written
    ScanFolder(std::filesystem::path folder, ScanFormat format);
    /// Of a process that writes some of the scans of a rendering, in a folder that
    /// another one has made: removes nothing.
    /// @throws UsageError for a recording, which one process writes; else as above
    static ScanFolder joining(std::filesystem::path folder, ScanFormat format);
    /// Writes the files of one scan. @param frame  its number @throws DataError as
    /// write_atomically()
    void write(int frame, const RenderedScan& scan);
    /// Writes scans.json and gives recordings their names: to be called after the last
    /// scan.
    void finish();
    const std::filesystem::path& path() const { return folder_; }
    /// What scans.json says of the scans written so far, JSON without a line break each;
    /// and takes what other processes have written.
    const std::vector<std::string>& entries() const { return entries_; }
    void set_entries(std::vector<std::string> entries) { entries_ = std::move(entries); }

private:
    struct Joining {};
    ScanFolder(std::filesystem::path folder, ScanFormat format, Joining);

    std::filesystem::path folder_;
    ScanFormat format_;
    std::vector<std::string> entries_;
    std::vector<ChannelInfo> channels_;  ///< of the scans, beside the basic ones
    /// shared so that a folder can be moved; none of a process that joins
    std::shared_ptr<ScanRecordings> recordings_;

    bool wants(const std::string& format) const;  ///< one of ScanFormat::formats
    void summarise() const;
};

/// What the npz of a scan holds, in that order. @param frame  its number
std::vector<NamedArray> scan_arrays(const RenderedScan& scan, int frame, const ScanFormat& format);

/// Names of the files of an earlier rendering in a folder, which a new ScanFolder would
/// remove.
std::vector<std::filesystem::path> scans_in(const std::filesystem::path& folder);

/// Pictures of an image: ranges in false colours that run with the square root of the
/// range, since near things are what a picture is for; intensities and drop probabilities
/// in gray. Pixels that do not return are dark gray.
Image range_picture(const RangeImage& image, double max_range_m);
Image intensity_picture(const RangeImage& image);
Image drop_picture(const RangeImage& image);
/// Range, intensity and drop probability stacked.
Image scan_picture(const RenderedScan& scan);
/// By how much a stack() enlarges an image vertically: a LiDAR row is taller than its
/// column is wide.
int picture_stretch(const RangeImage& image);
/// [rows*columns] 1 where a pixel returned, else 0
std::vector<float> returned_pixels(const RangeImage& image);

}  // namespace relidar
