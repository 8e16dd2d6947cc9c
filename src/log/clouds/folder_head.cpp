// SPDX-License-Identifier: Apache-2.0
// Reads sequence.json. An unknown key is an error, because a misspelt key would otherwise
// be replaced by its default value without a message.
#include "log/clouds/folder_head.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/clouds/other_formats.hpp"
#include "log/clouds/point_table.hpp"
#include "log/sensor/pattern_kinds.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

constexpr double kLargestOfHead = 1e12;   // maximum value of all lengths and times
constexpr double kFarthestWorld_m = 1e9;  // limit of the world's origin
constexpr std::int64_t kMaxFrame = 99999999;
constexpr std::size_t kMostFieldsOfPoint = 64;  // maximum number of fields of a point

std::string read_text_or(const JsonField& field, const std::string& key, const std::string& default_value,
                         std::size_t max_count = kLongestName) {
    return field.has(key) ? field.at(key).text(max_count) : default_value;
}

bool read_flag_or(const JsonField& field, const std::string& key, bool default_value) {
    return field.has(key) ? field.at(key).boolean() : default_value;
}

std::vector<std::string> read_texts_or_none(const JsonField& field, const std::string& key) {
    std::vector<std::string> texts;
    if (!field.has(key)) return texts;
    for (std::size_t i = 0; i < field.at(key).size(); ++i)
        texts.push_back(field.at(key).at(i).text(kLongestText));
    return texts;
}

/// Returns the index of a JSON text in a list of allowed words.
std::size_t read_choice(const JsonField& field, const std::vector<std::string>& words) {
    const auto at = std::find(words.begin(), words.end(), field.text());
    if (at == words.end())
        field.fail(fmt::format("found \"{}\"{}", make_excerpt(field.text()),
                               suggest_name(field.text(), words, "\"")),
                   fmt::format("expected one of: {}", fmt::join(words, ", ")));
    return std::size_t(at - words.begin());
}

glm::dquat read_quaternion(const JsonField& field) {
    const auto q = field.numbers<4>();
    const glm::dquat rotation(q[0], q[1], q[2], q[3]);
    if (std::abs(glm::length(rotation) - 1.0) > 1e-3)
        field.fail(fmt::format("found a quaternion of length {}", glm::length(rotation)), "expected 1");
    // Does not normalise the quaternion, because this would only change its last digits.
    // check_sequence() accepts small errors of its length.
    return rotation;
}

Pose read_mounting(const JsonField& field, const std::string& location) {
    if (field.is_array()) {
        const auto m = field.numbers<16>();
        return make_rigid_pose(glm::dmat3(m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]),
                               {m[3], m[7], m[11]}, location);
    }
    field.check_members({"translation", "quaternion"});
    const auto t = field.at("translation").numbers<3>();
    return {read_quaternion(field.at("quaternion")), {t[0], t[1], t[2]}};
}

/// Sets the sensor of a LiDAR. The JSON field contains the name of a built-in sensor or
/// of a sensor file.
void read_sensor_name(const JsonField& field, const fs::path& folder, bool spins, Lidar& lidar) {
    const std::string name = field.text(kLongestPath);
    // maximum range, used if the sensor file does not contain one
    const double max_range_m = lidar.sensor.max_range_m;
    const auto is_file = [&](const char* ending) { return name.find(ending) != std::string::npos; };
    const SensorModel model =
        find_sensor(is_file(".csv") || is_file(".json") || is_file(".npz") ? (folder / name).string() : name,
                    {}, max_range_m);
    if (!std::holds_alternative<SpinningSensor>(model.pattern) && spins)
        field.fail(fmt::format("found the sensor {}, which does not spin", make_excerpt(name)),
                   "expected a spinning sensor, or \"spins\": false");
    set_sensor(lidar, model);
}

/// Reads the sensor of a LiDAR from a JSON object: {"<kind>": {...}}, or the keys of a
/// spinning sensor. If the sweep period is missing, the reader uses the time between
/// frames.
void read_sensor(const JsonField& field, bool spins, Lidar& lidar) {
    const double max_range_m = lidar.sensor.max_range_m;
    const PatternKind* kind = find_pattern_kind(field);
    const JsonField members = kind ? field.at(kind->name) : field;
    set_sensor(lidar, kind ? read_sensor_json(field, "") : make_spinning_kind().parse(field, ""));
    if (lidar.pattern && spins)
        field.fail(fmt::format("found a sensor of kind {}, which does not spin", kind->name),
                   "expected a spinning sensor, or \"spins\": false");
    if (!lidar.pattern && !members.has("period_s")) lidar.sensor.period_s = 0.0;
    if (!members.has("max_range_m")) lidar.sensor.max_range_m = max_range_m;
}

HeadLidar read_lidar(const JsonField& field, const std::string& file, const fs::path& folder,
                     double max_range_m) {
    field.check_members({"name", "vehicle_from_sensor", "sensor", "scans", "spins", "ring_0"});
    HeadLidar lidar;
    lidar.lidar.name = read_text_or(field, "name", "");
    lidar.lidar.sensor.max_range_m = max_range_m;
    if (field.has("vehicle_from_sensor"))
        lidar.lidar.vehicle_from_sensor = read_mounting(
            field.at("vehicle_from_sensor"),
            fmt::format("{}: LiDAR '{}', vehicle_from_sensor", file, make_excerpt(lidar.lidar.name)));
    lidar.spins = read_flag_or(field, "spins", true);
    if (field.has("sensor") && field.at("sensor").is_text())
        read_sensor_name(field.at("sensor"), folder, lidar.spins, lidar.lidar);
    else if (field.has("sensor")) read_sensor(field.at("sensor"), lidar.spins, lidar.lidar);
    lidar.has_beams = !lidar.lidar.sensor.beams.empty();
    if (lidar.has_beams && !lidar.spins)
        field.at("spins").fail("found false for a LiDAR with beams",
                               "expected true, or a LiDAR without beams");
    lidar.scans = read_text_or(field, "scans", "", kLongestPath);
    lidar.lowest_first = field.has("ring_0") && read_choice(field.at("ring_0"), {"highest", "lowest"}) == 1;
    return lidar;
}

std::vector<HeadLidar> read_lidars(const JsonField& root, const std::string& file, const fs::path& folder,
                                   double max_range_m) {
    std::vector<HeadLidar> lidars;
    if (root.has("lidars")) {
        const JsonField field = root.at("lidars");
        for (std::size_t i = 0; i < field.size(); ++i)
            lidars.push_back(read_lidar(field.at(i), file, folder, max_range_m));
        if (lidars.empty()) field.fail("found no LiDAR", "expected at least one LiDAR, or no key \"lidars\"");
    } else {
        lidars.emplace_back().lidar.sensor.max_range_m = max_range_m;
    }
    for (HeadLidar& lidar : lidars)
        if (lidar.scans.empty()) lidar.scans = lidars.size() == 1 ? "scans" : "scans/" + lidar.lidar.name;
    return lidars;
}

int find_lidar_number(const JsonField& entry, const std::vector<HeadLidar>& lidars) {
    if (!entry.has("lidar") && lidars.size() == 1) return 0;
    const std::string name = entry.at("lidar").text();
    const auto at =
        std::find_if(lidars.begin(), lidars.end(), [&](const HeadLidar& l) { return l.lidar.name == name; });
    if (at == lidars.end())
        entry.at("lidar").fail(fmt::format("found \"{}\"", make_excerpt(name)),
                               "expected the name of a LiDAR in \"lidars\"");
    return int(at - lidars.begin());
}

std::vector<HeadFrame> read_listed_frames(const JsonField& field, const std::vector<HeadLidar>& lidars,
                                          const fs::path& folder) {
    std::vector<HeadFrame> frames;
    for (std::size_t i = 0; i < field.size(); ++i) {
        const JsonField entry = field.at(i);
        entry.check_members({"number", "time_s", "lidar", "scan"});
        frames.push_back({int(entry.at("number").integer(0, kMaxFrame)),
                          entry.at("time_s").number(-kLargestOfHead, kLargestOfHead),
                          find_lidar_number(entry, lidars), folder / entry.at("scan").text(kLongestPath)});
    }
    if (frames.empty()) field.fail("found no frame", "expected at least one frame");
    return frames;
}

/// Returns true for a CSV file directly in the folder of the log. Such a file may be a
/// table of beams instead of a scan.
bool can_be_beam_table(const fs::path& file, const fs::path& folder) {
    return file.extension() == ".csv" && file.parent_path() == folder;
}

/// Returns true if a file contains numbers as text, according to its extension.
bool is_text(const fs::path& file) { return file.extension() == ".csv" || file.extension() == ".xyz"; }

/// Lists the scan files of each LiDAR, sorted by name. Frame times are computed from the
/// constant frame rate `rate_hz`.
std::vector<HeadFrame> find_frames_in_folders(double rate_hz, const std::vector<HeadLidar>& lidars,
                                              const fs::path& folder) {
    std::vector<HeadFrame> frames;
    for (std::size_t l = 0; l < lidars.size(); ++l) {
        int number = 0;
        const std::vector<fs::path> files = list_folder((folder / lidars[l].scans).lexically_normal());
        // Text files are scans only if the folder has no other scans, because they may
        // contain time stamps instead.
        const bool has_scans = std::ranges::any_of(
            files, [](const fs::path& f) { return !is_text(f) && (is_point_file(f) || is_image_file(f)); });
        for (const fs::path& file : files)
            if ((is_point_file(file) && !can_be_beam_table(file, folder) && !(has_scans && is_text(file))) ||
                is_image_file(file)) {
                frames.push_back({number, number / rate_hz, int(l), file});
                ++number;
            }
        const std::string other = number == 0 ? describe_other_files(folder / lidars[l].scans) : "";
        if (number == 0)
            throw DataError(fmt::format(
                "{}: no scan was found{}{}, expected files that end in .npz, .exr, .pcd, .ply, .bin, .npy, "
                ".csv, .xyz or .las",
                (folder / lidars[l].scans).string(), other.empty() ? "" : ": ", other));
    }
    return frames;
}

PointUnits read_units(const JsonField& root) {
    PointUnits units;
    units.columns = read_texts_or_none(root, "columns");
    if (units.columns.size() > kMostFieldsOfPoint)
        root.at("columns").fail(fmt::format("found {}", units.columns.size()),
                                fmt::format("expected at most {} names", kMostFieldsOfPoint));
    if (root.has("intensity_max"))
        units.intensity_max = root.at("intensity_max").number(1e-12, kLargestOfHead);
    constexpr double kSeconds[] = {1.0, 1e-3, 1e-6, 1e-9};
    if (root.has("time_unit"))
        units.time_unit_s = kSeconds[read_choice(root.at("time_unit"), {"s", "ms", "us", "ns"})];
    units.absolute_times =
        root.has("point_times") && read_choice(root.at("point_times"), {"offsets", "absolute"}) == 1;
    return units;
}

}  // namespace

Head read_head(const fs::path& folder, double max_range_m) {
    const std::string file = (folder / kHeadFile).string();
    const nlohmann::json json = parse_json(read_text(file), file);
    const JsonField root(json, file, "");
    root.check_members({"format", "version", "relidar", "name", "conventions", "notes", "lidars", "frames",
                        "rate_hz", "motion_compensated", "columns", "intensity_max", "time_unit",
                        "point_times", "world_offset_m"});
    if (root.at("format").text() != kFormat)
        root.at("format").fail("found another format", fmt::format("expected \"{}\"", kFormat));
    root.at("version").integer(1, kVersion);
    Head head;
    head.name = read_text_or(root, "name", folder.filename().string());
    head.conventions =
        read_text_or(root, "conventions", "Sensor frame: x forward, y left, z up, in metres.", kLongestText);
    head.notes = read_texts_or_none(root, "notes");
    head.lidars = read_lidars(root, file, folder, max_range_m);
    if (root.has("frames") == root.has("rate_hz"))
        root.fail(root.has("frames") ? "found both \"frames\" and \"rate_hz\""
                                     : "found neither \"frames\" nor \"rate_hz\"",
                  "expected exactly one of the two keys");
    head.frames = root.has("frames")
                      ? read_listed_frames(root.at("frames"), head.lidars, folder)
                      : find_frames_in_folders(root.at("rate_hz").number(1e-3, 1e3), head.lidars, folder);
    std::stable_sort(head.frames.begin(), head.frames.end(),
                     [](const HeadFrame& first, const HeadFrame& second) {
                         return std::pair(first.time_s, first.lidar) < std::pair(second.time_s, second.lidar);
                     });
    head.motion_compensated = read_flag_or(root, "motion_compensated", false);
    head.units = read_units(root);
    std::vector<std::string> skipped;
    std::ranges::copy_if(head.units.columns, std::back_inserter(skipped),
                         [](const std::string& c) { return !is_point_field(c); });
    if (!skipped.empty())
        head.notes.push_back(
            fmt::format("columns of the scans that are not read: {}", fmt::join(skipped, ", ")));
    if (root.has("world_offset_m")) {
        const auto v = root.at("world_offset_m").numbers<3>();
        for (std::size_t i = 0; i < 3; ++i)
            root.at("world_offset_m").at(i).number(-kFarthestWorld_m, kFarthestWorld_m);
        head.world_offset_m = glm::dvec3(v[0], v[1], v[2]);
    }
    return head;
}

}  // namespace relidar::folder
