// SPDX-License-Identifier: Apache-2.0
// Reads sequence.json. An unknown key is an error, because it can be a misspelt key.
#include "read/scans/folder_head.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>

#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/log/log_time.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/sensor/pattern_kinds.hpp"
#include "log/sequence/georeference_json.hpp"
#include "read/files/other_formats.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

constexpr double kLargestOfHead = 1e12;   // maximum value of all lengths and times
constexpr double kFarthestWorld_m = 1e9;  // limit of the world's origin
constexpr std::int64_t kMaxFrame = 99999999;
constexpr std::size_t kMostFieldsOfPoint = 64;  // maximum number of fields of a point
// A scan is missing if scan numbers differ by this multiple of the smallest difference.
constexpr double kMissingScan = 1.5;

std::string read_text_or(const JsonField& field, const std::string& key, const std::string& default_value,
                         std::size_t max_length = kLongestName) {
    return field.has_member(key) ? field.at(key).short_text(max_length) : default_value;
}

bool read_flag_or(const JsonField& field, const std::string& key, bool default_value) {
    return field.has_member(key) ? field.at(key).boolean() : default_value;
}

std::vector<std::string> read_text_list(const JsonField& field, const std::string& key) {
    std::vector<std::string> texts;
    if (!field.has_member(key)) return texts;
    for (std::size_t i = 0; i < field.at(key).size(); ++i)
        texts.push_back(field.at(key).at(i).short_text(kLongestText));
    return texts;
}

std::size_t read_word_index(const JsonField& field, const std::vector<std::string>& allowed_words) {
    const auto at = std::find(allowed_words.begin(), allowed_words.end(), field.text());
    if (at == allowed_words.end())
        field.reject(fmt::format("found \"{}\"{}", quote(field.text()),
                                 did_you_mean(field.text(), allowed_words, "\"")),
                     fmt::format("expected one of: {}", fmt::join(allowed_words, ", ")));
    return std::size_t(at - allowed_words.begin());
}

glm::dquat read_quaternion(const JsonField& field) {
    const auto q = field.numbers<4>();
    const glm::dquat rotation(q[0], q[1], q[2], q[3]);
    if (std::abs(glm::length(rotation) - 1.0) > 1e-3)
        field.reject(fmt::format("found a quaternion of length {}", glm::length(rotation)),
                     "expected a quaternion of length 1");
    // Does not normalise, because this would change the last digits.
    return rotation;
}

/// Accepts a 4 x 4 matrix by rows, or a translation and a quaternion.
Pose read_mounting(const JsonField& field, const std::string& where) {
    if (field.is_array()) {
        const auto m = field.numbers<16>();
        if (std::max({std::abs(m[12]), std::abs(m[13]), std::abs(m[14]), std::abs(m[15] - 1.0)}) > 1e-6)
            fail("{}: found a matrix with the last row {} {} {} {}, expected 0 0 0 1 (transposed?)", where,
                 m[12], m[13], m[14], m[15]);
        return make_pose(m, where);
    }
    field.check_members({"translation", "quaternion"});
    const auto t = field.at("translation").numbers<3>();
    return {read_quaternion(field.at("quaternion")), {t[0], t[1], t[2]}};
}

/// Sets the sensor of a LiDAR from the name of a built-in sensor or of a sensor file.
void read_named_sensor(const JsonField& field, const fs::path& folder, bool must_spin, Lidar& lidar) {
    const std::string name = field.short_text(kLongestPath);
    const double max_range_m = lidar.sensor.max_range_m;
    const auto is_file = [&](const char* ending) { return name.find(ending) != std::string::npos; };
    const auto find_model = [&] {
        try {
            return find_sensor(
                is_file(".csv") || is_file(".json") || is_file(".npz") ? (folder / name).string() : name, {},
                max_range_m);
        } catch (const UsageError& error) {  // The name is in a file, not on the command line.
            fail("{}: {}", (folder / kHeadFile).string(), error.what());
        }
    };
    const SensorModel model = find_model();
    if (!std::holds_alternative<SpinningSensor>(model.pattern) && must_spin)
        field.reject(fmt::format("found the sensor {}, which does not spin", quote(name)),
                     "expected a spinning sensor, or \"spins\": false");
    set_sensor(lidar, model);
}

/// Reads {"<kind>": {...}}, or a spinning sensor without a kind. Without period_s, the
/// period is 0 and later estimated from the time between frames.
void read_sensor_object(const JsonField& field, bool must_spin, Lidar& lidar) {
    const double max_range_m = lidar.sensor.max_range_m;
    const PatternKind* kind = find_kind(field);
    const JsonField members = kind ? field.at(kind->name) : field;
    set_sensor(lidar, kind ? read_sensor_json(field, "") : sensor::parse_spinning(field, ""));
    if (lidar.pattern && must_spin)
        field.reject(fmt::format("found a sensor of kind {}, which does not spin", kind->name),
                     "expected a spinning sensor, or \"spins\": false");
    if (!lidar.pattern && !members.has_member("period_s")) lidar.sensor.period_s = 0.0;
    if (!members.has_member("max_range_m")) lidar.sensor.max_range_m = max_range_m;
}

HeaderLidar read_lidar(const JsonField& field, const std::string& json_file, const fs::path& folder,
                       double default_max_range_m) {
    field.check_members({"name", "vehicle_from_sensor", "sensor", "scans", "spins", "ring_0"});
    HeaderLidar lidar;
    lidar.lidar.name = read_text_or(field, "name", "");
    lidar.lidar.sensor.max_range_m = default_max_range_m;
    if (field.has_member("vehicle_from_sensor"))
        lidar.lidar.vehicle_from_sensor = read_mounting(
            field.at("vehicle_from_sensor"),
            fmt::format("{}: LiDAR '{}', vehicle_from_sensor", json_file, quote(lidar.lidar.name)));
    lidar.spins = read_flag_or(field, "spins", true);
    if (field.has_member("sensor") && field.at("sensor").is_string())
        read_named_sensor(field.at("sensor"), folder, lidar.spins, lidar.lidar);
    else if (field.has_member("sensor")) read_sensor_object(field.at("sensor"), lidar.spins, lidar.lidar);
    lidar.has_beams = !lidar.lidar.sensor.beams.empty();
    if (lidar.has_beams && !lidar.spins)
        field.at("spins").reject("found false, but the key sensor defines the beams of a spinning LiDAR",
                                 "expected true, or a sensor without a list of beams");
    lidar.scans = read_text_or(field, "scans", "", kLongestPath);
    // read_word_index() returns the position of the word in the list. Without the key,
    // ring 0 is the highest.
    lidar.lowest_first =
        field.has_member("ring_0") && read_word_index(field.at("ring_0"), {"highest", "lowest"}) == 1;
    return lidar;
}

std::vector<HeaderLidar> read_lidars(const JsonField& root, const std::string& json_file,
                                     const fs::path& folder, double default_max_range_m) {
    std::vector<HeaderLidar> lidars;
    if (root.has_member("lidars")) {
        const JsonField field = root.at("lidars");
        for (std::size_t i = 0; i < field.size(); ++i)
            lidars.push_back(read_lidar(field.at(i), json_file, folder, default_max_range_m));
        if (lidars.empty())
            field.reject("found no LiDAR", "expected at least one LiDAR, or no key \"lidars\"");
    } else {
        lidars.emplace_back().lidar.sensor.max_range_m = default_max_range_m;
    }
    for (HeaderLidar& lidar : lidars)
        if (lidar.scans.empty()) lidar.scans = lidars.size() == 1 ? "scans" : "scans/" + lidar.lidar.name;
    return lidars;
}

/// Returns the index of a frame's LiDAR. A frame may omit its LiDAR if the log has one.
int find_frame_lidar(const JsonField& frame_entry, const std::vector<HeaderLidar>& lidars) {
    if (!frame_entry.has_member("lidar") && lidars.size() == 1) return 0;
    const std::string name = frame_entry.at("lidar").text();
    const auto at = std::find_if(lidars.begin(), lidars.end(),
                                 [&](const HeaderLidar& l) { return l.lidar.name == name; });
    if (at == lidars.end())
        frame_entry.at("lidar").reject(fmt::format("found \"{}\"", quote(name)),
                                       "expected the name of a LiDAR in \"lidars\"");
    return int(at - lidars.begin());
}

std::vector<LogFrame> read_frame_list(const JsonField& frame_list, const std::vector<HeaderLidar>& lidars,
                                      const fs::path& folder) {
    std::vector<LogFrame> frames;
    for (std::size_t i = 0; i < frame_list.size(); ++i) {
        const JsonField entry = frame_list.at(i);
        entry.check_members({"number", "time_s", "lidar", "scan"});
        frames.push_back({int(entry.at("number").integer_in(0, kMaxFrame)),
                          entry.at("time_s").number_in(-kLargestOfHead, kLargestOfHead),
                          find_frame_lidar(entry, lidars),
                          folder / entry.at("scan").short_text(kLongestPath)});
    }
    if (frames.empty()) frame_list.reject("found no frame", "expected at least one frame");
    return frames;
}

bool is_text_file(const fs::path& file) { return file.extension() == ".csv" || file.extension() == ".xyz"; }

/// Other programs and systems make such files for their own use.
bool is_hidden_file(const fs::path& file) { return file.filename().string().starts_with('.'); }

/// Lists the scan files of each LiDAR, sorted by name. Computes frame times from the
/// constant frame rate `rate_hz`.
std::vector<LogFrame> list_folder_frames(double rate_hz, const std::vector<HeaderLidar>& lidars,
                                         const fs::path& folder) {
    std::vector<LogFrame> frames;
    for (std::size_t l = 0; l < lidars.size(); ++l) {
        std::map<std::string, fs::path> scan_of_stem;
        const std::vector<fs::path> files = list_folder((folder / lidars[l].scans).lexically_normal());
        // Text files next to other scans may contain time stamps.
        const bool has_scans = std::ranges::any_of(files, [](const fs::path& f) {
            return !is_text_file(f) && (is_point_file(f) || is_image_file(f)) && !is_hidden_file(f);
        });
        for (const fs::path& file : files) {
            // A CSV file directly in the folder of the log may be a table of beams.
            const bool can_be_beam_table = file.extension() == ".csv" && file.parent_path() == folder;
            const bool has_points =
                is_point_file(file) && !can_be_beam_table && !(has_scans && is_text_file(file));
            if (is_hidden_file(file) || !(has_points || is_image_file(file))) continue;
            const int number = int(scan_of_stem.size());
            const auto [other, is_new] = scan_of_stem.try_emplace(file.stem().string(), file);
            if (!is_new)
                fail("{}: the scan {} has the same name, expected one file for each scan", file.string(),
                     other->second.filename().string());
            frames.push_back({number, number / rate_hz, int(l), file});
        }
        if (!scan_of_stem.empty()) continue;
        const std::string other = find_unsupported(folder / lidars[l].scans);
        fail(
            "{}: no scan was found{}{}, expected files that end in .npz, .exr, .pcd, .ply, .bin, .npy, "
            ".csv, .xyz or .las",
            (folder / lidars[l].scans).string(), other.empty() ? "" : ": ", other);
    }
    return frames;
}

/// Returns a note about the first scan that is probably missing, or an empty text.
/// Accepts scans with regular gaps, such as every fifth scan.
/// @param stems  file names without extension
std::string note_missing_scan(const std::vector<std::string>& stems) {
    std::vector<int> steps;
    for (std::size_t i = 0; i < stems.size(); ++i) {
        const std::optional<int> number = parse_stem(stems[i]);
        if (!number) return "";
        if (i > 0) steps.push_back(*number - *parse_stem(stems[i - 1]));
    }
    if (steps.empty()) return "";
    const int smallest = std::ranges::min(steps);
    const auto is_gap = [&](int step) {
        return smallest > 0 ? double(step) >= kMissingScan * double(smallest) : step <= 0;
    };
    const auto gap = std::ranges::find_if(steps, is_gap);
    if (gap == steps.end()) return "";
    const std::string *before = &stems[std::size_t(gap - steps.begin())], *after = before + 1;
    return smallest > 0 ? fmt::format("no scan was found between {} and {}", *before, *after)
                        : fmt::format(
                              "the scans are sorted by name, so {} is before {}, because the numbers "
                              "have no leading zeros",
                              *before, *after);
}

std::vector<std::string> note_missing_scans(const std::vector<LogFrame>& frames,
                                            const std::vector<HeaderLidar>& lidars) {
    std::vector<std::string> notes;
    std::vector<std::vector<std::string>> stems(lidars.size());
    for (const LogFrame& frame : frames)
        stems[std::size_t(frame.lidar)].push_back(frame.scan.stem().string());
    for (std::size_t l = 0; l < lidars.size(); ++l) {
        if (std::string note = note_missing_scan(stems[l]); !note.empty()) notes.push_back(std::move(note));
        if (stems[l].size() != stems[0].size())
            notes.push_back(fmt::format("LiDAR '{}' has {} scans, but LiDAR '{}' has {}",
                                        lidars[l].lidar.name, stems[l].size(), lidars[0].lidar.name,
                                        stems[0].size()));
    }
    for (std::string& note : notes)
        note +=
            "; with \"rate_hz\", the position of a scan in its folder determines its time and its pose; use "
            "the key \"frames\" in sequence.json if scans are missing";
    return notes;
}

PointFileUnits read_units(const JsonField& root) {
    PointFileUnits units;
    units.columns = read_text_list(root, "columns");
    if (units.columns.size() > kMostFieldsOfPoint)
        root.at("columns").reject(fmt::format("found {} names", units.columns.size()),
                                  fmt::format("expected at most {} names", kMostFieldsOfPoint));
    if (root.has_member("intensity_max"))
        units.intensity_max = root.at("intensity_max").number_in(1e-12, kLargestOfHead);
    constexpr double kUnitSeconds[] = {1.0, 1e-3, 1e-6, 1e-9};
    if (root.has_member("time_unit"))
        units.time_unit_s = kUnitSeconds[read_word_index(root.at("time_unit"), {"s", "ms", "us", "ns"})];
    units.absolute_times = root.has_member("point_times") &&
                           read_word_index(root.at("point_times"), {"offsets", "absolute"}) == 1;
    return units;
}

}  // namespace

SequenceHeader read_header(const fs::path& folder, double default_max_range_m) {
    const std::string file = (folder / kHeadFile).string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    root.check_members({"format", "version", "relidar", "name", "conventions", "notes", "lidars", "frames",
                        "rate_hz", "motion_compensated", "columns", "intensity_max", "time_unit",
                        "point_times", "world_offset_m", "georeference", "start_unix_ns"});
    if (root.at("format").text() != kLogFormat)
        root.at("format").reject("found another format", fmt::format("expected \"{}\"", kLogFormat));
    root.at("version").integer_in(1, kLogVersion);
    SequenceHeader head;
    head.name = read_text_or(root, "name", folder.filename().string());
    head.conventions =
        read_text_or(root, "conventions", "Sensor frame: x forward, y left, z up, in metres.", kLongestText);
    std::ranges::copy(read_text_list(root, "notes"), std::back_inserter(head.notes));
    if (root.has_member("start_unix_ns"))
        head.start_unix_ns = root.at("start_unix_ns").integer_in(0, kLatestLogStart_ns);
    head.lidars = read_lidars(root, file, folder, default_max_range_m);
    if (root.has_member("frames") == root.has_member("rate_hz"))
        root.reject(root.has_member("frames") ? "found both \"frames\" and \"rate_hz\""
                                              : "found neither \"frames\" nor \"rate_hz\"",
                    "expected exactly one of the two keys");
    head.frames = root.has_member("frames")
                      ? read_frame_list(root.at("frames"), head.lidars, folder)
                      : list_folder_frames(root.at("rate_hz").number_in(1e-3, 1e3), head.lidars, folder);
    if (root.has_member("rate_hz"))
        std::ranges::copy(note_missing_scans(head.frames, head.lidars), std::back_inserter(head.notes));
    std::stable_sort(head.frames.begin(), head.frames.end(),
                     [](const LogFrame& first, const LogFrame& second) {
                         return std::pair(first.time_s, first.lidar) < std::pair(second.time_s, second.lidar);
                     });
    head.motion_compensated = read_flag_or(root, "motion_compensated", false);
    head.units = read_units(root);
    std::vector<std::string> skipped;
    std::ranges::copy_if(head.units.columns, std::back_inserter(skipped),
                         [](const std::string& c) { return !is_known_field(c); });
    if (!skipped.empty())
        head.notes.push_back(
            fmt::format("these columns of the scans are not read: {}", fmt::join(skipped, ", ")));
    if (root.has_member("georeference")) {
        head.georeference = read_georeference(root.at("georeference"));
        if (has_proj()) GeoConverter{*head.georeference};  // rejects an unknown projection
    }
    if (root.has_member("world_offset_m")) {
        const auto v = root.at("world_offset_m").numbers<3>();
        for (std::size_t i = 0; i < 3; ++i)
            root.at("world_offset_m").at(i).number_in(-kFarthestWorld_m, kFarthestWorld_m);
        head.world_offset_m = glm::dvec3(v[0], v[1], v[2]);
    }
    return head;
}

}  // namespace relidar::read
