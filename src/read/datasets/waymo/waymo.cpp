// SPDX-License-Identifier: Apache-2.0
// Reads Waymo Open. In the frame of the LiDAR, pixel (row, column) of a range image is a
// ray with
//   elevation(row),  azimuth pi - 2 pi (column + 0.5) / columns - yaw of the mounting.
// The reader rotates the frame by this yaw, so that the image has the rays of a spinning
// sensor.
//
// The dataset has moved the points of TOP with the vehicle pose of their pixel. It has
// moved the points of the other LiDARs with the vehicle pose of the record. The reader
// computes the ray in the world with the same pose. Then it converts the ray to the
// vehicle frame of the log at the time of the ray.
#include "read/readers.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <span>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/read/clouds.hpp>
#include "base/codecs/tfrecord.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/median.hpp"
#include "base/progress_blocks.hpp"
#include "log/classes/dataset_classes.hpp"
#include "read/datasets/waymo/waymo_frame.hpp"
#include "read/lidar_rt_benchmark.hpp"
#include "read/scans/broken_scans.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace waymo;

/// [numbers in Waymo's enum LaserName] Name of each LiDAR; number 0 is unused.
constexpr const char* kLaserNames[] = {"", "TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"};

/// Lists the .tfrecord files (segments) of a folder, or returns the file.
std::vector<std::string> list_segments(const fs::path& file_or_folder) {
    std::vector<std::string> files;
    std::error_code failed;
    if (!fs::is_directory(file_or_folder, failed)) return {file_or_folder.string()};
    for (const fs::path& file : list_folder(file_or_folder))
        if (file.extension() == ".tfrecord") files.push_back(file.string());
    if (files.empty()) fail("{} contains no segment, expected files *.tfrecord", file_or_folder.string());
    return files;
}

/// Selects the file that the setting dataset.sequence names by the beginning of its name,
/// or the first file. The setting may also name a part of the benchmark of the LiDAR-RT
/// paper (ws1, wd1, ...), which is a range of frames of a segment.
DriveFrames choose_segment(const fs::path& file_or_folder, const DatasetOptions& options) {
    const std::vector<std::string> files = list_segments(file_or_folder);
    const auto is_called = [](const fs::path& file, const std::string& name) {
        const std::string file_name = file.filename().string();
        return file_name.starts_with(name) || file_name.starts_with("segment-" + name);
    };
    if (const auto segment = choose_drive(files, "segments", options, kWaymoBenchmark, is_called))
        return *segment;
    fail<UsageError>(
        "dataset.sequence: found '{}', which selects none of the {} segments in {}; expected the beginning "
        "of a segment's name; ws1 to ws4 and wd1 to wd4 (parts of the LiDAR-RT paper) need the segments that "
        "the paper uses",
        quote(options.sequence), files.size(), file_or_folder.string());
}

std::string record_location(const TfRecordReader& records, int record_index) {
    return fmt::format("{}: record {}", records.file_path().string(), record_index);
}

/// Returns the vehicle pose at the time of a pixel. Channels: roll, pitch, yaw, x, y, z.
Pose read_pixel_pose(const InflatedImage& pose_image, std::size_t pixel_index) {
    const float* v = pose_image.pixel_values(pixel_index);
    return {make_rotation(double(v[2]), double(v[1]), double(v[0])), {v[3], v[4], v[5]}};
}

// Channels of the range image: range, intensity, elongation, no-label zone. Channels of
// the pose image: roll, pitch, yaw, x, y, z.
constexpr int kImageChannels = 4, kPoseChannels = 6;

/// Reads the image with the vehicle pose of each pixel, which only some LiDARs have.
std::optional<InflatedImage> read_pose_image(const LaserImages& laser_images,
                                             const InflatedImage& range_image, const std::string& place) {
    if (laser_images.pixel_pose.empty()) return std::nullopt;
    InflatedImage poses = inflate_image(laser_images.pixel_pose, kPoseChannels, place + ", pixel poses");
    if (poses.rows != range_image.rows || poses.columns != range_image.columns)
        fail("{}: found {} x {} pixel poses for an image of {} x {} pixels, expected the same size", place,
             poses.rows, poses.columns, range_image.rows, range_image.columns);
    return poses;
}

const LaserImages& find_laser_images(const SegmentFrame& record, int laser_id, const std::string& place) {
    for (const LaserImages& images : record.images)
        if (images.laser == laser_id && !images.first.empty()) return images;
    fail("{}: the range image of the LiDAR {} is missing, but the first frame has one", place,
         kLaserNames[laser_id]);
}

/// Returns the index of the pixel with a return that is nearest to the middle column, or
/// nothing for an image without returns.
std::optional<std::size_t> find_middle_return(const InflatedImage& range_image) {
    const std::size_t n_pixels = std::size_t(range_image.rows) * std::size_t(range_image.columns);
    std::optional<std::size_t> nearest;
    int nearest_columns = range_image.columns;  // distance from the middle
    for (std::size_t pixel = 0; pixel < n_pixels; ++pixel) {
        const int column = int(pixel % std::size_t(range_image.columns));
        const int columns_from_middle = std::abs(column - range_image.columns / 2);
        const bool has_return = range_image.pixel_values(pixel)[0] > 0.0f;
        if (!has_return || columns_from_middle >= nearest_columns) continue;
        nearest = pixel;
        nearest_columns = columns_from_middle;
    }
    return nearest;
}

/// Returns the vehicle pose at which the roof LiDAR (TOP) faces forward. The middle
/// column of its image faces forward, and Waymo stores a vehicle pose for each pixel with
/// a return. Without such a pixel, returns the pose of the record.
Pose forward_pose(const SegmentFrame& frame_record, const std::string& place) {
    // Images are sorted by LiDAR, and TOP is the first.
    if (frame_record.images.empty() || frame_record.images.front().laser != kTopLaser)
        return frame_record.world_from_vehicle;
    const LaserImages& top = frame_record.images.front();
    const std::string in_top = place + ": TOP";
    const InflatedImage image = inflate_image(top.first, kImageChannels, in_top);
    const std::optional<InflatedImage> poses = read_pose_image(top, image, in_top);
    const std::optional<std::size_t> middle = find_middle_return(image);
    return poses && middle ? read_pixel_pose(*poses, *middle) : frame_record.world_from_vehicle;
}

/// Data of a frame without its scans. All headers are read before any scan, because a ray
/// is moved with the interpolated poses of all frames.
struct WaymoFrameHeader {
    std::int64_t timestamp_us = 0;
    Pose world_from_vehicle;       ///< vehicle pose at the time when the head of the LiDAR faces forward
    std::vector<BoxLabel> labels;  ///< box labels in the world frame; their times are not set
};

WaymoFrameHeader read_header(const TfRecordReader& records, int record_index) {
    const std::string data = records.read_record(std::size_t(record_index)),
                      where = record_location(records, record_index);
    SegmentFrame frame = parse_frame(data, where);
    for (BoxLabel& label : frame.labels)
        label.world_from_box = frame.world_from_vehicle * label.world_from_box;
    return {frame.timestamp_us, forward_pose(frame, where), std::move(frame.labels)};
}

/// Returns the median time between frames, which is the duration of a revolution. A
/// single frame gets 0.1 s, the nominal duration of Waymo's LiDARs.
/// @throws DataError if the duration is not plausible
double frame_period_s(const std::vector<WaymoFrameHeader>& frame_headers, const std::string& place) {
    constexpr double kNominalPeriod_s = 0.1;
    std::vector<double> steps_s;
    for (std::size_t i = 1; i < frame_headers.size(); ++i)
        steps_s.push_back(1e-6 * double(frame_headers[i].timestamp_us - frame_headers[i - 1].timestamp_us));
    if (steps_s.empty()) return kNominalPeriod_s;
    const double period_s = compute_median(std::move(steps_s));
    if (!(period_s > 0.01 && period_s < 1.0))
        fail("{}: timestamp_micros increase by {:.6g} s per record, expected 0.01 to 1 s", place, period_s);
    return period_s;
}

const LaserCalibration& find_calibration(const SegmentFrame& frame_record, int laser_id,
                                         const std::string& place) {
    const auto calibration = std::ranges::find(frame_record.lasers, laser_id, &LaserCalibration::laser);
    if (calibration == frame_record.lasers.end())
        fail("{}: laser_calibrations has no entry for the LiDAR {}, although its range image exists", place,
             kLaserNames[laser_id]);
    return *calibration;
}

/// Returns the model of a LiDAR: beams, columns and pose on the vehicle. Waymo does not
/// store a model, so it follows from the calibration and the size of the range image.
Lidar make_waymo_lidar(const SegmentFrame& frame_record, const LaserImages& laser_images, double period_s,
                       const std::string& place) {
    if (laser_images.laser < 1 || laser_images.laser >= int(std::size(kLaserNames)))
        fail("{}: found the laser number {}, expected 1 to {}", place, laser_images.laser,
             std::size(kLaserNames) - 1);
    const LaserCalibration& calibration = find_calibration(frame_record, laser_images.laser, place);
    Lidar lidar{kLaserNames[laser_images.laser], {}, {}};
    const InflatedImage image =
        inflate_image(laser_images.first, kImageChannels, fmt::format("{}: {}", place, lidar.name));

    lidar.sensor.name = fmt::format("Waymo {}", lidar.name);
    lidar.sensor.columns = image.columns;
    lidar.sensor.period_s = period_s;
    // Column 0 is half a column clockwise from straight backward (azimuth pi).
    lidar.sensor.first_azimuth_rad = kPi - kPi / image.columns;
    for (const double elevation : row_elevations_rad(calibration, image.rows, place))
        lidar.sensor.beams.push_back({elevation});

    // Removes the yaw, because the middle column of an image faces the vehicle's front.
    const glm::dvec3 ahead = calibration.vehicle_from_laser.rotation * glm::dvec3(1, 0, 0);
    const Pose without_yaw{glm::angleAxis(-std::atan2(ahead.y, ahead.x), glm::dvec3(0, 0, 1)), {}};
    lidar.vehicle_from_sensor = calibration.vehicle_from_laser * without_yaw;
    return lidar;
}

/// Converts the range images of a LiDAR to a scan with one ray per pixel.
class RangeImageReader {
public:
    /// Creates a reader for one LiDAR in one frame.
    /// @param model_rays  rays of the LiDAR without correction for its motion
    /// @param clamps  true: intensities are clamped to 1; false: scaled with tanh
    RangeImageReader(const Log& log, const Frame& frame, RayTable model_rays, std::string place, bool clamps)
        : lidar_(log.lidar_of(frame)), where_(std::move(place)), clamps_(clamps) {
        scan.rays = std::move(model_rays);
        scan.range_m.assign(scan.rays.size(), 0.0f);
        scan.intensity.assign(scan.rays.size(), 0.0f);
        // All rays of a column fire at the same time, so one pose per column is enough.
        for (int column = 0; column < scan.rays.columns; ++column) {
            const double time_s = frame.time_s + double(scan.rays.time_offset_s[std::size_t(column)]);
            sensor_from_world_.push_back(
                inverse(log.world_from_vehicle.mounted_pose_at(time_s, lidar_.vehicle_from_sensor)));
        }
    }

    Scan scan;

    /// Fills `scan` with the returns, classes and second returns of the images.
    /// @param world_from_vehicle  vehicle pose of the frame, for LiDARs without pixel
    /// poses
    void to_scan(const LaserImages& lidar_images, const Pose& world_from_vehicle) {
        const InflatedImage image = inflate_scan_image(lidar_images.first);
        const std::optional<InflatedImage> poses = read_pose_image(lidar_images, image, where_);
        copy_returns(image, scan.range_m, scan.intensity);
        for (std::size_t ray = 0; ray < scan.rays.size(); ++ray)
            if (!poses) correct_ray(ray, world_from_vehicle);
            else if (scan.range_m[ray] > 0.0f) correct_ray(ray, read_pixel_pose(*poses, ray));
        if (!lidar_images.labels.empty()) copy_classes(lidar_images.labels);
        if (!lidar_images.second.empty()) copy_second_returns(lidar_images.second);
    }

private:
    const Lidar& lidar_;
    std::string where_;
    bool clamps_;
    /// [columns] when the column fires
    std::vector<Pose> sensor_from_world_;

    InflatedImage inflate_scan_image(std::string_view compressed_image, int n_channels = kImageChannels,
                                     PixelType pixel_type = PixelType::real) const {
        InflatedImage image = inflate_image(compressed_image, n_channels, where_, pixel_type);
        if (image.rows == scan.rays.rows && image.columns == scan.rays.columns) return image;
        fail("{}: the range image has {} x {} pixels, expected {} x {} like in the first frame", where_,
             image.rows, image.columns, scan.rays.rows, scan.rays.columns);
    }

    float normalise(float stored_intensity) const {
        return clamps_ ? std::clamp(stored_intensity, 0.0f, 1.0f)
                       : std::tanh(std::max(stored_intensity, 0.0f));
    }

    /// Copies channels 0 (range) and 1 (intensity) of each pixel. A pixel without a
    /// return has a range of at most 0 in Waymo's files. It gets the range 0 and the
    /// intensity 0.
    void copy_returns(const InflatedImage& range_image, std::span<float> range_m,
                      std::span<float> intensity) const {
        for (std::size_t ray = 0; ray < range_m.size(); ++ray) {
            const float range = range_image.pixel_values(ray)[0],
                        brightness = range_image.pixel_values(ray)[1];
            range_m[ray] = std::max(range, 0.0f);
            intensity[ray] = range > 0.0f ? normalise(brightness) : 0.0f;
        }
    }

    /// Sets the class of each ray with a return.
    void copy_classes(std::string_view compressed_labels) {
        constexpr int kLabelChannels = 2, kClassChannel = 1;  // channel 0 is the object instance
        const InflatedImage labels =
            inflate_scan_image(compressed_labels, kLabelChannels, PixelType::integer);
        scan.classes.assign(scan.rays.size(), SurfaceClass::unknown);
        for (std::size_t ray = 0; ray < scan.rays.size(); ++ray)
            if (scan.range_m[ray] > 0.0f)
                scan.classes[ray] =
                    from_waymo(int(std::clamp(labels.pixel_values(ray)[kClassChannel], 0.0f, 255.0f)));
    }

    /// Adds the second returns. Ignores those of rays without a first return.
    void copy_second_returns(std::string_view compressed_image) {
        AdditionalReturns& second = scan.second_returns.emplace_back(
            AdditionalReturns{to_vector(scan.range_m), to_vector(scan.intensity)});
        copy_returns(inflate_scan_image(compressed_image), second.range_m, second.intensity);
        for (std::size_t ray = 0; ray < scan.rays.size(); ++ray)
            if (scan.range_m[ray] == 0.0f) second.range_m[ray] = second.intensity[ray] = 0.0f;
    }

    /// Changes the ray in the sensor frame, so that the interpolated pose of the log puts
    /// it at the correct place in the world. The dataset has an exact vehicle pose for
    /// each ray, but the log only interpolates between vehicle poses.
    /// @param world_from_vehicle  exact vehicle pose for this ray
    void correct_ray(std::size_t ray_index, const Pose& world_from_vehicle) {
        const Pose moved = sensor_from_world_[ray_index % std::size_t(scan.rays.columns)] *
                           (world_from_vehicle * lidar_.vehicle_from_sensor);
        scan.rays.origin[ray_index] = glm::vec3(moved.translation);
        scan.rays.direction[ray_index] =
            glm::vec3(moved.rotation * glm::dvec3(scan.rays.direction[ray_index]));
    }
};

/// Returns the LiDARs that have a range image in a record.
std::vector<Lidar> read_waymo_lidars(const TfRecordReader& records, int record_index, double period_s,
                                     bool only_top_lidar) {
    const std::string record = records.read_record(std::size_t(record_index)),
                      where = record_location(records, record_index);
    const SegmentFrame frame = parse_frame(record, where);
    std::vector<Lidar> lidars;
    for (const LaserImages& images : frame.images)
        if (!images.first.empty() && (!only_top_lidar || images.laser == kTopLaser))
            lidars.push_back(make_waymo_lidar(frame, images, period_s, where));
    if (lidars.empty())
        fail("{}: found no range image{} in the record, expected at least one", where,
             only_top_lidar ? " of the LiDAR TOP" : "");
    return lidars;
}

/// Adds LiDARs, frames and box labels to the log, but no scans. The first loaded record
/// defines the LiDARs. Time 0 is the first record of the file, even if it is not loaded.
/// @param frame_headers  headers of the loaded records, beginning with `first_record`
void add_segment_frames(Log& log, const TfRecordReader& records,
                        const std::vector<WaymoFrameHeader>& frame_headers, int first_record,
                        bool only_top_lidar) {
    const double period_s = frame_period_s(frame_headers, records.file_path().string());
    log.lidars = read_waymo_lidars(records, first_record, period_s, only_top_lidar);
    const std::int64_t start_us =
        parse_frame(records.read_record(0), record_location(records, 0)).timestamp_us;
    set_log_start(log, 1000 * start_us, "on the clock of the dataset");

    std::vector<BoxLabel> labels;
    for (std::size_t i = 0; i < frame_headers.size(); ++i) {
        // The time stamp is the start of the sweep, when the head faces backward. The
        // time of a frame is half a period later, when the head faces forward.
        const double time_s = 1e-6 * double(frame_headers[i].timestamp_us - start_us) + 0.5 * period_s;
        for (int lidar = 0; lidar < int(log.lidars.size()); ++lidar)
            add_frame(log, first_record + int(i), time_s, frame_headers[i].world_from_vehicle, lidar);
        for (BoxLabel label : frame_headers[i].labels) {
            label.time_s = time_s;
            labels.push_back(std::move(label));
        }
    }
    log.boxes = build_tracks(labels);
}

/// Returns the rays of each LiDAR, without correction for motion. The dataset has ray
/// times only for the roof LiDAR (TOP). Rays of other LiDARs get the time of the frame.
std::vector<RayTable> make_model_rays(const std::vector<Lidar>& lidars) {
    std::vector<RayTable> models;
    for (const Lidar& lidar : lidars) {
        RayTable& model = models.emplace_back(make_rays(lidar.sensor));
        if (lidar.name != kLaserNames[kTopLaser])
            std::fill(model.time_offset_s.begin(), model.time_offset_s.end(), 0.0f);
    }
    return models;
}

/// Reads the scan of one LiDAR from a parsed record.
/// @param place  name of the record, for error messages
Scan read_laser_scan(const Log& log, const Frame& frame, const SegmentFrame& record,
                     const RayTable& model_rays, const std::string& place, bool clamps_intensity) {
    const std::string& name = log.lidar_of(frame).name;
    const int laser_id = int(std::ranges::find(kLaserNames, name) - std::begin(kLaserNames));
    RangeImageReader reader(log, frame, model_rays, fmt::format("{}: {}", place, name), clamps_intensity);
    reader.to_scan(find_laser_images(record, laser_id, place), record.world_from_vehicle);
    return std::move(reader.scan);
}

/// Reads the scans of all frames in parallel. A broken scan is an error, or is skipped if
/// the user allows it. The LiDARs of a sweep have consecutive frames in the log, and
/// their images are in one record, which is parsed only once.
void read_record_scans(Log& log, const TfRecordReader& records, const DatasetOptions& options) {
    ScanErrorCollector broken(options.skip_broken);
    const std::vector<RayTable> model_rays = make_model_rays(log.lidars);
    const std::size_t n_lidars = log.lidars.size(), n_sweeps = log.frames.size() / n_lidars;
    progress_for(n_sweeps, options.progress, "reading range images", [&](std::size_t sweep) {
        const std::size_t first_frame = sweep * n_lidars;
        const int record_index = log.frames[first_frame].index;
        const std::string data = records.read_record(std::size_t(record_index)),
                          where = record_location(records, record_index);
        const SegmentFrame record = parse_frame(data, where);
        for (std::size_t lidar = 0; lidar < n_lidars; ++lidar) {
            Frame& frame = log.frames[first_frame + lidar];
            broken.guard(first_frame + lidar, [&] {
                frame.scan = read_laser_scan(log, frame, record, model_rays[lidar], where,
                                             options.waymo.clamp_intensity);
            });
        }
    });
    broken.remove_broken(log);
}

}  // namespace

/// Loads a segment of Waymo Open: poses, LiDARs, boxes and scans. A frame number is the
/// index of a record in the file.
Log load_waymo(const fs::path& path, const DatasetOptions& options) {
    const DriveFrames segment = choose_segment(path, options);
    const fs::path file = segment.drive;
    const TfRecordReader records(file);
    constexpr std::size_t kMaxRecords = 1 << 30;  // frame numbers are int
    const int n_records = int(std::min(records.size(), kMaxRecords));
    const FrameRange loaded = limit_frames(segment.frames, n_records, segment.drive);
    std::vector<WaymoFrameHeader> headers(std::size_t(loaded.end - loaded.begin));
    progress_for(headers.size(), options.progress, "reading poses", [&](std::size_t index) {
        headers[index] = read_header(records, loaded.begin + int(index));
    });

    Log log;
    log.name = file.stem().string();
    log.source = path.string();
    log.conventions =
        "Vehicle frame: x forward, y left, z up, in metres. Times are seconds after the first firing. At the "
        "time of a frame, the head of TOP faces forward. The intensity is " +
        std::string(options.waymo.clamp_intensity ? "Waymo's value clamped at 1"
                                                  : "the tanh of Waymo's value") +
        ". Rays of TOP have individual firing times. All rays of another LiDAR have the same time.";
    log.notes = segment.notes;
    log.test_frames = segment.test_frames;
    const bool only_top = segment.is_benchmark;  // as in the LiDAR-RT paper
    add_segment_frames(log, records, headers, loaded.begin, only_top);
    for (Lidar& lidar : log.lidars) lidar.sensor.max_range_m = options.max_range_m;
    // The scans need the poses of the dataset, so the user's poses replace them later.
    read_record_scans(log, records, options);
    read::replace_poses(log, options);
    centre_log(log);
    return log;
}

}  // namespace relidar
