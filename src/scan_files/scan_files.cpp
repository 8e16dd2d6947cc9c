// SPDX-License-Identifier: Apache-2.0
#include <relidar/scan_files.hpp>

#include <algorithm>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/export.hpp>
#include <relidar/render.hpp>
#include <relidar/run.hpp>
#include "scan_files/scan_entry.hpp"
#include "scan_files/scan_recording.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using scan_files::RecordedActor;
using scan_files::RecordedScan;

constexpr const char* kUnits = "metres, seconds; intensity and drop_prob 0 to 1";

/// A scan with its rays in the frame that was asked for.
struct PlacedScan {
    const RenderedScan& scan;
    const ScanFormat& format;
    int frame;                                  ///< the dataset's number
    std::vector<glm::vec3> origin, direction, normal;   ///< [n], normals where they were rendered
    std::optional<std::vector<float>> spread_m;         ///< [n] where it was asked for
    FileNotes notes;

    const RangeImage& image() const { return scan.image; }
};

/// @param notes  of its files
PlacedScan place(const RenderedScan& scan, const ScanFormat& format, int frame, FileNotes notes = {}) {
    PlacedScan placed{scan, format, frame, scan.image.origin, scan.image.direction, scan.normal, {}, std::move(notes)};
    if (format.config.render.spread) placed.spread_m = range_spread(scan);
    const bool world = format.frame == PointFrame::world;
    if (!world && !format.deskew) return placed;
    const Pose target_from_world = world ? Pose{} : inverse(placed.scan.world_from_sensor);
    for (std::size_t i = 0; i < placed.origin.size(); ++i) {
        const Pose target_from_firing = target_from_world * placed.scan.world_from_firing(i);
        placed.origin[i] = glm::vec3(target_from_firing * glm::dvec3(placed.origin[i]));
        placed.direction[i] = glm::vec3(glm::normalize(target_from_firing.rotation * glm::dvec3(placed.direction[i])));
        if (!placed.normal.empty()) placed.normal[i] = glm::vec3(target_from_firing.rotation * glm::dvec3(placed.normal[i]));
    }
    return placed;
}

/// Row by row.
std::vector<double> matrix_of(const Pose& pose) {
    const glm::dmat4 columns = to_matrix(pose);
    std::vector<double> numbers;
    for (int row = 0; row < 4; ++row)
        for (int column = 0; column < 4; ++column) numbers.push_back(columns[column][row]);
    return numbers;
}

std::string frame_text(const ScanFormat& format) {
    if (format.frame == PointFrame::world) return "world: the dataset's own";
    return format.deskew ? "sensor at time_s: x forward, y left, z up" : "sensor at each ray's firing time: x forward, y left, z up";
}

FileNotes notes_of(const ScanFormat& format, int frame, const RenderedScan& scan) {
    return {{"relidar", RELIDAR_VERSION},
            {"run", format.run},
            {"sensor", format.sensor},
            {"frame_number", fmt::format("{}", frame)},
            {"time_s", fmt::format("{}", scan.time_s)},
            {"points_in", frame_text(format)},
            {"points_range", format.config.render.points == "median" ? "median" : format.config.render.range},
            {"world_from_sensor", fmt::format("{}", fmt::join(matrix_of(scan.world_from_sensor), " "))},
            {"units", kUnits}};
}

template <class T>
NamedArray image_array(const char* name, const RangeImage& image, const std::vector<T>& values) {
    return make_array(name, {static_cast<std::size_t>(image.rows), static_cast<std::size_t>(image.columns)}, values.data(), values.size());
}

NamedArray vector_array(const char* name, const RangeImage& image, const std::vector<glm::vec3>& values) {
    const float* first = values.empty() ? nullptr : &values.front().x;
    return make_array(name, {static_cast<std::size_t>(image.rows), static_cast<std::size_t>(image.columns), 3}, first, values.size() * 3);
}

std::vector<NamedArray> arrays_of(const PlacedScan& placed) {
    const RenderedScan& scan = placed.scan;
    const RangeImage& image = scan.image;
    const std::vector<double> pose = matrix_of(scan.world_from_sensor);
    const bool world = placed.format.frame == PointFrame::world;
    const std::int32_t number = placed.frame, deskewed = world || placed.format.deskew ? 1 : 0;
    std::vector<NamedArray> arrays{image_array("range", image, image.range_m),
                                   image_array("median_range", image, scan.median_range_m),
                                   image_array("intensity", image, image.intensity),
                                   image_array("drop_prob", image, image.drop_prob),
                                   image_array("weight", image, scan.weight),
                                   image_array("time", image, scan.time_offset_s),
                                   image_array("ring", image, scan.channel),
                                   image_array("instance", image, scan.instance),
                                   make_text_array("instance_names", placed.format.instance_names),
                                   vector_array("directions", image, placed.direction),
                                   vector_array("origin", image, placed.origin),
                                   make_array("pose", {4, 4}, pose.data(), pose.size()),
                                   make_array("time_s", {}, &scan.time_s, 1),
                                   make_array("frame_number", {}, &number, 1),
                                   make_text("frame", world ? "world" : "sensor"),
                                   make_array("deskewed", {}, &deskewed, 1),
                                   make_text("sensor", placed.format.sensor),
                                   make_text("run", placed.format.run),
                                   make_text("units", kUnits)};
    if (!placed.normal.empty()) arrays.push_back(vector_array("normals", image, placed.normal));
    if (placed.spread_m) arrays.push_back(image_array("spread", image, *placed.spread_m));
    if (!scan.seen.empty()) arrays.push_back(image_array("seen", image, scan.seen));
    if (scan.unseen_share) arrays.push_back(make_array("unseen", {}, &*scan.unseen_share, 1));
    if (!scan.further.empty()) {
        arrays.push_back(image_array("range_2", image, scan.further[0].range_m));
        arrays.push_back(image_array("intensity_2", image, scan.further[0].intensity));
    }
    return arrays;
}

void exr(const fs::path& path, const PlacedScan& placed) {
    const RenderedScan& scan = placed.scan;
    const RangeImage& image = scan.image;
    std::map<std::string, std::vector<float>> channels{{"range", image.range_m},         {"median_range", scan.median_range_m},
                                                       {"intensity", image.intensity},   {"drop_prob", image.drop_prob},
                                                       {"weight", scan.weight},          {"time", scan.time_offset_s},
                                                       {"instance", {scan.instance.begin(), scan.instance.end()}},
                                                       {"ring", {scan.channel.begin(), scan.channel.end()}}};
    if (placed.spread_m) channels["spread"] = *placed.spread_m;
    if (!scan.seen.empty()) channels["seen"] = scan.seen;
    if (!scan.further.empty()) channels["range_2"] = scan.further[0].range_m, channels["intensity_2"] = scan.further[0].intensity;
    constexpr const char* kAxes = "xyz";
    for (int axis = 0; axis < 3; ++axis) {
        const auto add = [&](const char* name, const std::vector<glm::vec3>& vectors) {
            for (const glm::vec3& v : vectors) channels[fmt::format("{}.{}", name, kAxes[axis])].push_back(v[axis]);
        };
        add("origin", placed.origin), add("direction", placed.direction), add("normal", placed.normal);
    }
    write_exr(path, image.rows, image.columns, channels, placed.notes);
}

/// Whether a ray gives a point at this range.
bool is_point(const RenderedScan& scan, std::size_t ray, float range_m) {
    return returned(scan.image.drop_prob[ray], range_m);
}

/// @param number  of the return, from 1; normal, instance and spread are known of the first
void add_point(PointCloud& cloud, const PlacedScan& placed, std::size_t ray, float range_m, float intensity, int number) {
    const RenderedScan& scan = placed.scan;
    cloud.position_m.push_back(placed.origin[ray] + range_m * placed.direction[ray]);
    cloud.intensity.push_back(intensity);
    cloud.ring->push_back(scan.channel[ray]);
    cloud.time->push_back(scan.time_offset_s[ray]);
    cloud.instance->push_back(number == 1 ? scan.instance[ray] : -1);
    if (cloud.normal) cloud.normal->push_back(number == 1 ? placed.normal[ray] : glm::vec3(0.0f));
    if (cloud.spread) cloud.spread->push_back(number == 1 ? (*placed.spread_m)[ray] : 0.0f);
    if (cloud.seen) cloud.seen->push_back(scan.seen[ray]);
    if (cloud.return_number) cloud.return_number->push_back(static_cast<std::uint8_t>(number));
}

PointCloud cloud_of(const PlacedScan& placed) {
    const RenderedScan& scan = placed.scan;
    const std::vector<float>& range_m = point_ranges(scan, placed.format.config);
    PointCloud cloud;
    cloud.ring.emplace(), cloud.time.emplace(), cloud.instance.emplace();
    if (!placed.normal.empty()) cloud.normal.emplace();
    if (placed.spread_m) cloud.spread.emplace();
    if (!scan.seen.empty()) cloud.seen.emplace();
    cloud.notes = placed.notes;
    if (!scan.further.empty()) cloud.return_number.emplace();
    if (placed.format.frame == PointFrame::sensor) cloud.world_from_points = scan.world_from_sensor;
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        if (!is_point(scan, i, range_m[i])) continue;
        add_point(cloud, placed, i, range_m[i], scan.image.intensity[i], 1);
        if (!scan.further.empty() && scan.further[0].range_m[i] > 0.0f)
            add_point(cloud, placed, i, scan.further[0].range_m[i], scan.further[0].intensity[i], 2);
    }
    return cloud;
}

std::size_t count_points(const RenderedScan& scan, const Config& config) {
    const std::vector<float>& range_m = point_ranges(scan, config);
    std::size_t n = 0;
    for (std::size_t i = 0; i < range_m.size(); ++i) n += is_point(scan, i, range_m[i]);
    return n;
}

/// Boxes of those who are there at a time, in the dataset's world.
std::vector<RecordedActor> actors_at(const ScanFormat& format, double time_s) {
    std::vector<RecordedActor> actors;
    for (const BoxTrack& box : format.actors) {
        if (!box.present(time_s)) continue;
        Pose pose = box.world_from_box.at(time_s);
        pose.translation += format.world_offset_m;
        actors.push_back({box.id, pose, box.size_m});
    }
    return actors;
}

RecordedScan recorded(const PlacedScan& placed) {
    const RenderedScan& scan = placed.scan;
    const std::vector<float>& times = scan.time_offset_s;
    RecordedScan result;
    result.cloud = cloud_of(placed);
    result.world = placed.format.frame == PointFrame::world;
    result.first_time_s = times.empty() ? 0.0 : double(*std::min_element(times.begin(), times.end()));
    result.world_from_sensor = scan.world_from_sensor;
    result.world_from_sensor_at_first = scan.track.pose.empty() ? scan.world_from_sensor : scan.track.at(scan.time_s + result.first_time_s);
    result.actors = actors_at(placed.format, scan.time_s);
    return result;
}

void npz(const fs::path& path, const PlacedScan& placed) { write_npz(path, arrays_of(placed)); }
void ply(const fs::path& path, const PlacedScan& placed) { write_ply(path, cloud_of(placed)); }
void pcd(const fs::path& path, const PlacedScan& placed) { write_pcd(path, cloud_of(placed)); }
void bin(const fs::path& path, const PlacedScan& placed) { write_kitti_bin(path, cloud_of(placed)); }
void png(const fs::path& path, const PlacedScan& placed) { write_png(path, scan_picture(placed.scan), placed.notes); }

struct Format {
    const char* name;   ///< and extension
    void (*write)(const fs::path&, const PlacedScan&);
};
constexpr Format kFormats[] = {{"npz", npz}, {"exr", exr}, {"ply", ply}, {"pcd", pcd}, {"bin", bin}, {"png", png}};

}  // namespace

std::vector<std::string> scan_formats() {
    std::vector<std::string> names;
    for (const Format& format : kFormats) names.emplace_back(format.name);
    names.insert(names.end(), std::begin(scan_files::kRecordingKinds), std::end(scan_files::kRecordingKinds));
    return names;
}

ScanFormat scan_format(const Run& run, const SensorChoice& sensor) {
    ScanFormat format;
    for (const Instance& instance : run.scene.instances) {
        format.instance_names.push_back(instance.track.empty() ? "background" : instance.track);
    }
    for (const BoxTrack& box : run.sequence.boxes)
        if (std::find(format.instance_names.begin(), format.instance_names.end(), box.id) != format.instance_names.end())
            format.actors.push_back(box);
    format.world_offset_m = run.sequence.world_offset_m;
    if (!run.folder.empty()) format.run = fs::absolute(run.folder).lexically_normal().string();
    format.sensor = sensor.name;
    format.limits = sensor.limits;
    format.config = run.config;
    if (sensor.returns > 0) format.config.sensor.returns = sensor.returns;
    return format;
}

std::vector<NamedArray> scan_arrays(const RenderedScan& scan, int frame, const ScanFormat& format) {
    return arrays_of(place(scan, format, frame));
}

bool ScanFolder::wants(const std::string& format) const {
    return std::find(format_.formats.begin(), format_.formats.end(), format) != format_.formats.end();
}

void ScanFolder::write(int frame, const RenderedScan& scan) {
    const PlacedScan placed = place(scan, format_, frame, notes_of(format_, frame, scan));
    std::vector<std::string> files;
    for (const Format& format : kFormats) {
        if (!wants(format.name)) continue;
        files.push_back(fmt::format("frame_{:06}.{}", frame, format.name));
        format.write(folder_ / files.back(), placed);
    }
    for (const Recording& recording : recordings_) recording.file->add(recorded(placed), scan.time_s);
    entries_.push_back(scan_files::entry_json(frame, scan, count_points(scan, format_.config), files));
}

}  // namespace relidar
