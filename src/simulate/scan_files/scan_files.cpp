// SPDX-License-Identifier: Apache-2.0
#include <relidar/simulate/scan_files.hpp>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/camera.hpp>
#include <relidar/simulate/point_files.hpp>
#include "log/georeference/georeference_json.hpp"
#include "simulate/scan_files/placed_scan.hpp"
#include "simulate/scan_files/recording_format.hpp"
#include "simulate/scan_files/scan_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using scan_files::ScanInOutputFrame;

constexpr const char* kUnitsText = "metres, seconds; intensity and drop_prob 0 to 1";

std::string describe_frame(const ScanOutputOptions& options) {
    const char* axes = options.camera ? "x right, y down, z forward" : "x forward, y left, z up";
    if (options.frame == PointCoordinateFrame::world && options.map)
        return fmt::format("{}: x, y and height in metres", options.map->crs());
    if (options.frame == PointCoordinateFrame::world) return "world: the dataset's own";
    return fmt::format("sensor at {}: {}", has_common_frame(options) ? "time_s" : "each ray's firing time",
                       axes);
}

/// Returns the texts that describe a scan in the headers of its files.
FileMetadata scan_metadata(const ScanOutputOptions& format, int frame, const RenderedScan& scan) {
    return {{"relidar", RELIDAR_VERSION},
            {"run", format.run},
            {"sensor", format.sensor},
            {"frame_number", fmt::format("{}", frame)},
            {"time_s", fmt::format("{}", scan.time_s)},
            {"points_in", describe_frame(format)},
            {"points_range", format.config.render.points == "median" ? "median" : format.config.render.range},
            {"world_from_sensor",
             fmt::format("{}", fmt::join(scan_files::row_major(scan.world_from_sensor), " "))},
            {"units", kUnitsText}};
}

/// Adds the origin of positions to the metadata of a file in single precision.
FileMetadata add_origin(FileMetadata notes, const std::optional<glm::dvec3>& origin_m) {
    if (origin_m && *origin_m != glm::dvec3(0.0))
        notes.push_back({"world_offset_m", fmt::format("{} {} {}", origin_m->x, origin_m->y, origin_m->z)});
    return notes;
}

template <class T>
NamedArray image_array(const std::string& name, const RangeImage& image, const std::vector<T>& values) {
    return make_array(name, {static_cast<std::size_t>(image.rows), static_cast<std::size_t>(image.columns)},
                      values.data(), values.size());
}

NamedArray image_array(const std::string& name, const RangeImage& image, const std::vector<glm::vec3>& xyz) {
    const float* first = xyz.empty() ? nullptr : &xyz.front().x;
    return make_array(name,
                      {static_cast<std::size_t>(image.rows), static_cast<std::size_t>(image.columns), 3},
                      first, xyz.size() * 3);
}

/// Returns an array of positions, [rows,columns,3]. Positions in the world have double
/// precision, because their coordinates can be large.
/// @param world_origin_m origin of the positions in the world; no value for other frames
NamedArray position_array(const std::string& name, const RangeImage& image, const std::vector<glm::vec3>& xyz,
                          const std::optional<glm::dvec3>& world_origin_m) {
    if (!world_origin_m) return image_array(name, image, xyz);
    std::vector<double> values;
    values.reserve(xyz.size() * 3);
    for (const glm::vec3& p : xyz)
        for (int axis = 0; axis < 3; ++axis) values.push_back((*world_origin_m)[axis] + double(p[axis]));
    return make_array(name, {std::size_t(image.rows), std::size_t(image.columns), 3}, values.data(),
                      values.size());
}

/// Adds the pictures of a camera, and its matrix.
void add_camera_arrays(std::vector<NamedArray>& arrays, const RenderedScan& scan, const Camera& camera) {
    const Image picture = draw_camera(scan);
    const std::size_t rows = std::size_t(picture.rows), columns = std::size_t(picture.columns);
    NamedArray gray{"picture", "u1", {rows, columns}, {}};
    for (std::size_t i = 0; i < picture.rgb.size(); i += 3) gray.bytes.push_back(std::byte(picture.rgb[i]));
    const double k[] = {camera.focal_x_px,
                        0.0,
                        camera.centre_x_px,
                        0.0,
                        camera.focal_y_px,
                        camera.centre_y_px,
                        0.0,
                        0.0,
                        1.0};
    arrays.push_back(std::move(gray));
    arrays.push_back(image_array("depth", scan.image, draw_depth(scan).values));
    arrays.push_back(make_array("K", {3, 3}, k, 9));
}

/// Returns copies of all arrays of an npz file, see make_scan_format_help().
/// @param output_scan  not const, because it computes its rays at the first use
std::vector<NamedArray> make_npz_arrays(ScanInOutputFrame& output_scan) {
    const RenderedScan& scan = output_scan.scan;
    const ScanOutputOptions& format = output_scan.format;
    const RangeImage& image = scan.image;
    const std::vector<double> pose = scan_files::row_major(scan.world_from_sensor);
    const bool is_in_world = format.frame == PointCoordinateFrame::world;
    const std::int32_t frame_number = output_scan.frame;
    const std::int32_t is_deskewed = has_common_frame(format);  // not a frame per point
    const scan_files::PlacedRays& rays = output_scan.rays();
    const std::optional<glm::dvec3> origin_m = output_scan.world_origin_m();
    std::vector<NamedArray> arrays{make_text_array("instance_names", format.instance_names),
                                   image_array("directions", image, rays.direction),
                                   position_array("origin", image, rays.origin, origin_m),
                                   position_array("points", image, rays.end_m, origin_m),
                                   make_array("pose", {4, 4}, pose.data(), pose.size()),
                                   make_array("time_s", {}, &scan.time_s, 1),
                                   make_array("frame_number", {}, &frame_number, 1),
                                   single_text("frame", is_in_world ? "world" : "sensor"),
                                   make_array("deskewed", {}, &is_deskewed, 1),
                                   single_text("sensor", format.sensor),
                                   single_text("run", format.run),
                                   single_text("units", kUnitsText)};
    for_each_channel(output_scan, [&](const ChannelInfo& channel, const auto& values) {
        arrays.push_back(image_array(channel.name, image, values));
    });
    if (scan.unseen_share) arrays.push_back(make_array("unseen", {}, &*scan.unseen_share, 1));
    if (format.camera) add_camera_arrays(arrays, scan, *format.camera);
    return arrays;
}

/// Writers of the formats of single scans, see kScanFormats.
void write_npz_file(const fs::path& path, ScanInOutputFrame& scan) { write_npz(path, make_npz_arrays(scan)); }

/// Writes the images of a scan as float channels of an EXR file. Its metadata has the
/// origin of positions in the world.
void write_exr_file(const fs::path& path, ScanInOutputFrame& output_scan) {
    std::map<std::string, std::vector<float>> channels;
    const auto add = [&]<class T>(const std::string& name, const std::vector<T>& values) {
        if constexpr (std::is_same_v<T, glm::vec3>) {
            // A vector becomes three channels: name.x, name.y, name.z.
            for (const glm::vec3& v : values)
                for (int axis = 0; axis < 3; ++axis)
                    channels[fmt::format("{}.{}", name, "xyz"[axis])].push_back(v[axis]);
        } else {
            channels[name].assign(values.begin(), values.end());
        }
    };
    add("origin", output_scan.rays().origin);
    add("direction", output_scan.rays().direction);
    for_each_channel(output_scan,
                     [&](const ChannelInfo& channel, const auto& values) { add(channel.name, values); });
    const RangeImage& image = output_scan.scan.image;
    write_exr(path, image.rows, image.columns, channels,
              add_origin(output_scan.notes, output_scan.world_origin_m()));
}

void write_ply_file(const fs::path& path, ScanInOutputFrame& scan) {
    write_ply(path, scan.points(), scan.notes, scan.world_origin_m());
}
void write_pcd_file(const fs::path& path, ScanInOutputFrame& scan) {
    write_pcd(path, scan.points(), scan.notes, scan.world_origin_m());
}
/// Returns GeoConverter::wkt(). Keeps the last text, because PROJ takes some 10 ms.
const std::string& find_wkt(const Georeference& place) {
    thread_local std::string last_place, wkt;
    if (const std::string text = georeference_json(place).dump(); text != last_place) {
        wkt = GeoConverter(place).wkt();
        last_place = text;
    }
    return wkt;
}
void write_las_file(const fs::path& path, ScanInOutputFrame& scan) {
    const std::optional<Georeference>& place = scan.format.georeference;
    const bool is_on_earth = scan.world_origin_m() && place && has_proj();
    const std::optional<MapProjector>& map = scan.format.map;
    const std::string wkt = !is_on_earth ? "" : map ? map->map().wkt() : find_wkt(*place);
    write_las(path, scan.points(), scan.notes, scan.world_origin_m(), wkt);
}
void write_bin_file(const fs::path& path, ScanInOutputFrame& scan) { write_kitti_bin(path, scan.points()); }
void write_png_file(const fs::path& path, ScanInOutputFrame& scan) {
    write_png(path, scan.format.camera ? draw_camera(scan.scan) : draw_scan(scan.scan), scan.notes);
}

struct ScanFileFormat {
    const char* name;  ///< name of the format, which is also the extension of its files
    const char* help;  ///< content of a file; one or more lines
    void (*write)(const fs::path&, ScanInOutputFrame&);
};
constexpr const char* kPointsHelp =
    R"(the points of rays with drop_prob < 0.5, where half of the light is absorbed (the
median range). With --set render.points=range they use the mean range, which lies between two
surfaces at edges. The VIEWPOINT of a pcd is the pose in the dataset's world.)";
constexpr ScanFileFormat kScanFormats[] = {
    {"npz", R"(range, median_range, intensity, drop_prob, weight, time, ring [rows,columns]; directions,
origin, points [rows,columns,3]; pose [4,4], sensor to the dataset's world at time_s; instance_names.
Metres, seconds.)",
     write_npz_file},
    {"exr", "the images of npz as float channels.", write_exr_file},
    {"ply", kPointsHelp, write_ply_file},
    {"pcd", kPointsHelp, write_pcd_file},
    {"bin", kPointsHelp, write_bin_file},
    {"las", R"(LAS 1.4, point format 6, with ring, instance and channels as extra bytes; GPS time is
the log's time. With --crs it names the coordinate system; with --frame world, only if the
axes of the dataset's world are those of the map of its georeference.)",
     write_las_file},
    {"png", R"(pictures of range, intensity and drop_prob. Of a camera: its picture, and in
frame_000123_depth.png the depth, metres * 256 as in KITTI.)",
     write_png_file}};

}  // namespace

std::vector<std::string> scan_formats() {
    std::vector<std::string> names;
    for (const ScanFileFormat& format : kScanFormats) names.emplace_back(format.name);
    for (const scan_files::RecordingFormat& format : scan_files::recording_formats())
        names.emplace_back(format.name);
    names.emplace_back(scan_files::kPacketFormat);
    return names;
}

std::string make_scan_format_help() {
    std::vector<std::pair<std::string, std::string>> rows;
    for (const ScanFileFormat& format : kScanFormats) {
        // Formats with the same description share a line.
        if (!rows.empty() && rows.back().second == format.help)
            rows.back().first += fmt::format(", {}", format.name);
        else rows.emplace_back(format.name, format.help);
    }
    for (const scan_files::RecordingFormat& format : scan_files::recording_formats())
        rows.emplace_back(format.name, fmt::format("DIR/{}, {}", format.file, format.help));
    rows.emplace_back(scan_files::kPacketFormat, scan_files::kPacketHelp);
    std::string text;
    for (const auto& [names, help] : rows) text += fmt::format("{}: {}\n", names, help);
    return text;
}

std::int64_t time_shift_of(const Run& run, const SimulatedSensor& sensor, double first_scan_s) {
    if (std::isinf(first_scan_s) && !run.log.frames.empty()) first_scan_s = run.log.frames.front().time_s;
    double first_ray_s = sensor.pattern ? -scan_period_s(*sensor.pattern) : 0.0;
    for (const float t : sensor.rays.time_offset_s) first_ray_s = std::min(first_ray_s, 1.01 * double(t));
    return time_shift_of(run.log, first_scan_s + first_ray_s);
}

ScanOutputOptions default_options(const Run& run, const SimulatedSensor& sensor) {
    ScanOutputOptions format;
    const Scene& scene = run.scene;
    for (const ModelInstance& instance : scene.instances)
        format.instance_names.push_back(instance.track.empty() ? "background" : instance.track);
    for (const BoxTrack& box : run.log.boxes)
        if (std::ranges::find(format.instance_names, box.id) != format.instance_names.end())
            format.actors.push_back(box);
    // Standing objects are visible only if the scene has a background.
    if (scene.models.front().count > 0 || !scene.blocks.empty())
        format.standing = list_standing(scene, run.log, run.config.init);
    format.world_offset_m = run.log.world_offset_m;
    format.georeference = run.log.georeference;
    const Lidar& lidar = run.log.lidars[std::size_t(sensor.lidar)];
    format.vehicle_from_lidar = lidar.vehicle_from_sensor;
    format.rolling_shutter = is_rolling(sensor, run.config);
    name_topics(format, lidar.name);
    format.run = file_name_of(run.folder);
    format.sensor = sensor.name;
    format.camera = sensor.camera;
    format.limits = sensor.limits;
    if (sensor.is_log_lidar && !lidar.pattern) format.packets.sensor = lidar.sensor;
    format.time_shift_ns = time_shift_of(run, sensor);
    format.config = run.config;
    if (sensor.returns > 0) format.config.sensor.returns = sensor.returns;
    return format;
}

bool has_common_frame(const ScanOutputOptions& options) {
    return options.frame == PointCoordinateFrame::world || options.deskew || !options.rolling_shutter;
}

std::vector<NamedArray> scan_arrays(const RenderedScan& scan, int frame, const ScanOutputOptions& format) {
    ScanInOutputFrame placed(scan, format, frame);
    return make_npz_arrays(placed);
}

void ScanFolderWriter::write_scan(int frame, const RenderedScan& scan) {
    ScanInOutputFrame placed(scan, format_, frame, scan_metadata(format_, frame, scan));
    std::vector<std::string> files;
    for (const ScanFileFormat& format : kScanFormats) {
        if (std::ranges::find(format_.formats, format.name) == format_.formats.end()) continue;
        files.push_back(fmt::format("frame_{:06}.{}", frame, format.name));
        format.write(folder_ / files.back(), placed);
        if (format.write != write_png_file || !format_.camera) continue;
        files.push_back(fmt::format("frame_{:06}{}.png", frame, scan_files::kDepthEnding));
        write_png(folder_ / files.back(), draw_depth(scan), placed.notes);
    }
    if (recordings_) recordings_->write_scans({&scan, 1});
    for (const ScanChannel& channel : scan.channels)
        if (std::ranges::find(channels_, channel.info.name, &ChannelInfo::name) == channels_.end())
            channels_.push_back(channel.info);
    entries_.push_back(scan_files::entry_json(frame, scan, format_, files));
}

}  // namespace relidar
