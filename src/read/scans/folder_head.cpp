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
#include "log/frames/labelled_azimuth.hpp"
#include "log/georeference/georeference_json.hpp"
#include "log/sensor/pattern_kinds.hpp"
#include "read/files/other_formats.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

constexpr double kMaxHeaderNumber = 1e12;  // maximum value of all lengths and times
constexpr double kFarthestWorld_m = 1e9;   // limit of the world's origin
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

/// Returns a text that must be one of some words.
/// @throws DataError for another text, with the most similar word
std::string read_word(const JsonField& field, const std::vector<std::string>& allowed_words) {
    if (std::ranges::find(allowed_words, field.text()) == allowed_words.end())
        field.reject(fmt::format("found \"{}\"{}", quote(field.text()),
                                 did_you_mean(field.text(), allowed_words, "\"")),
                     fmt::format("expected one of: {}", fmt::join(allowed_words, ", ")));
    return field.text();
}

glm::dquat read_quaternion(const JsonField& field) {
    const auto q = field.numbers<4>();
    const glm::dquat rotation(q[0], q[1], q[2], q[3]);
    if (std::abs(glm::length(rotation) - 1.0) > 1e-3)
        field.reject(fmt::format("found a quaternion of length {}", glm::length(rotation)),
                     "expected a quaternion of length 1");
    // The quaternion is not normalised, because this would change the last digits.
    return rotation;
}

/// Reads the pose of a sensor: a 4 x 4 matrix by rows, or a translation and a quaternion.
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
/// @param folder  folder of the log, which contains sensor files
void read_named_sensor(const JsonField& field, const fs::path& folder, Lidar& lidar) {
    const std::string name = field.short_text(kLongestPath);
    const auto contains = [&](const char* ending) { return name.find(ending) != std::string::npos; };
    const bool is_file = contains(".csv") || contains(".json") || contains(".npz");
    try {
        set_sensor(lidar,
                   find_sensor(is_file ? (folder / name).string() : name, {}, lidar.sensor.max_range_m));
    } catch (const UsageError& error) {  // The name is in a file, not on the command line.
        fail("{}: {}", (folder / kHeadFile).string(), error.what());
    }
}

/// Sets the sensor of a LiDAR from a JSON object: {"<kind>": {members}}, or only the
/// members of a spinning sensor. max_range_m may be missing and then stays the same.
void read_sensor_object(const JsonField& field, Lidar& lidar) {
    const double default_max_range_m = lidar.sensor.max_range_m;
    const PatternKind* kind = find_kind(field);
    set_sensor(lidar, kind ? read_sensor_json(field, "") : sensor::parse_spinning(field, ""));
    const JsonField members = kind ? field.at(kind->name) : field;
    if (!members.has_member("max_range_m")) lidar.sensor.max_range_m = default_max_range_m;
    // 0: estimated later from the time between frames
    if (!members.has_member("period_s")) lidar.sensor.period_s = 0.0;
}

/// Reads an element of "lidars". A LiDAR with a list of beams must spin. Otherwise
/// "spins" tells whether beams can be estimated.
/// @param json_file  name for error messages
/// @param folder  folder of the log
HeaderLidar read_lidar(const JsonField& field, const std::string& json_file, const fs::path& folder,
                       double default_max_range_m) {
    field.check_members({"name", "vehicle_from_sensor", "sensor", "scans", "spins", "ring_0"});
    HeaderLidar header;
    Lidar& lidar = header.lidar;
    lidar.name = read_text_or(field, "name", "");
    lidar.sensor.max_range_m = default_max_range_m;
    if (field.has_member("vehicle_from_sensor"))
        lidar.vehicle_from_sensor =
            read_mounting(field.at("vehicle_from_sensor"),
                          fmt::format("{}: LiDAR '{}', vehicle_from_sensor", json_file, quote(lidar.name)));

    header.spins = read_flag_or(field, "spins", true);
    if (field.has_member("sensor")) {
        const JsonField sensor = field.at("sensor");
        if (sensor.is_string()) read_named_sensor(sensor, folder, lidar);
        else read_sensor_object(sensor, lidar);
        if (lidar.pattern && header.spins)
            sensor.reject("found a sensor that does not spin",
                          "expected a spinning sensor, or \"spins\": false");
    }
    header.has_beams = !lidar.sensor.beams.empty();
    if (header.has_beams && !header.spins)
        field.at("spins").reject("found false, but the key sensor defines the beams of a spinning LiDAR",
                                 "expected true, or a sensor without a list of beams");

    header.scans = read_text_or(field, "scans", "", kLongestPath);  // folder of the scans
    header.lowest_first =
        field.has_member("ring_0") && read_word(field.at("ring_0"), {"highest", "lowest"}) == "lowest";
    return header;
}

/// Reads the list "lidars". Without it, the log has one LiDAR without a name. The scans
/// of a single LiDAR are in the folder "scans", and those of several in "scans/<name>".
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
    const auto lidar =
        std::ranges::find_if(lidars, [&](const HeaderLidar& header) { return header.lidar.name == name; });
    if (lidar == lidars.end())
        frame_entry.at("lidar").reject(fmt::format("found \"{}\"", quote(name)),
                                       "expected the name of a LiDAR in \"lidars\"");
    return int(lidar - lidars.begin());
}

/// Reads the list "frames", which gives number, time and scan file of each frame.
std::vector<LogFrame> read_frame_list(const JsonField& frame_list, const std::vector<HeaderLidar>& lidars,
                                      const fs::path& folder) {
    std::vector<LogFrame> frames;
    for (std::size_t i = 0; i < frame_list.size(); ++i) {
        const JsonField entry = frame_list.at(i);
        entry.check_members({"number", "time_s", "lidar", "scan"});
        frames.push_back({.number = int(entry.at("number").integer_in(0, kMaxFrame)),
                          .time_s = entry.at("time_s").number_in(-kMaxHeaderNumber, kMaxHeaderNumber),
                          .lidar = find_frame_lidar(entry, lidars),
                          .scan = folder / entry.at("scan").short_text(kLongestPath)});
    }
    if (frames.empty()) frame_list.reject("found no frame", "expected at least one frame");
    return frames;
}

/// Lists the scan files of a LiDAR, sorted by name.
/// @param scan_folder  folder of the scans
/// @param log_folder  folder of the log; may be the same folder
/// @throws DataError if two files have the same name without its ending
std::vector<fs::path> list_scan_files(const fs::path& scan_folder, const fs::path& log_folder) {
    std::vector<fs::path> files = list_folder(scan_folder.lexically_normal());
    // Other programs and systems make hidden files for their own use.
    std::erase_if(files, [](const fs::path& file) { return file.filename().string().starts_with('.'); });
    const auto is_text_file = [](const fs::path& file) {
        return file.extension() == ".csv" || file.extension() == ".xyz";
    };
    // Text files next to other scans may contain time stamps.
    const bool has_other_scans = std::ranges::any_of(files, [&](const fs::path& file) {
        return !is_text_file(file) && (is_point_file(file) || is_image_file(file));
    });
    std::map<std::string, fs::path> scan_of_stem;  // stem: file name without its ending
    std::vector<fs::path> scans;
    for (const fs::path& file : files) {
        // A CSV file directly in the folder of the log may be a table of beams.
        const bool can_be_beam_table = file.extension() == ".csv" && file.parent_path() == log_folder;
        const bool can_be_stamps = has_other_scans && is_text_file(file);
        const bool has_points = is_point_file(file) && !can_be_beam_table && !can_be_stamps;
        if (!has_points && !is_image_file(file)) continue;
        const auto [other, is_new] = scan_of_stem.try_emplace(file.stem().string(), file);
        if (!is_new)
            fail("{}: the scan {} has the same name, expected one file for each scan", file.string(),
                 other->second.filename().string());
        scans.push_back(file);
    }
    return scans;
}

/// Lists the frames of all LiDARs from the files in their scan folders. Computes frame
/// times from the constant frame rate `rate_hz`.
std::vector<LogFrame> list_folder_frames(double rate_hz, const std::vector<HeaderLidar>& lidars,
                                         const fs::path& folder) {
    std::vector<LogFrame> frames;
    for (std::size_t l = 0; l < lidars.size(); ++l) {
        const std::vector<fs::path> scans = list_scan_files(folder / lidars[l].scans, folder);
        for (int number = 0; number < std::ssize(scans); ++number)
            frames.push_back({number, number / rate_hz, int(l), scans[std::size_t(number)]});
        if (!scans.empty()) continue;
        const std::string other = find_unsupported(folder / lidars[l].scans);
        fail(
            "{}: no scan was found{}{}, expected files that end in .npz, .exr, .pcd, .ply, .bin, .npy, "
            ".csv, .xyz or .las",
            (folder / lidars[l].scans).string(), other.empty() ? "" : ": ", other);
    }
    return frames;
}

/// Returns a note about the first scan of a LiDAR that is probably missing, or an empty
/// text. Accepts scans with regular gaps, such as every fifth scan.
/// @param stems  file names without extension
std::string note_missing_scan(const std::vector<std::string>& stems) {
    std::vector<int> steps;  // between the numbers of consecutive scans
    for (std::size_t i = 0; i < stems.size(); ++i) {
        const std::optional<int> number = parse_stem(stems[i]);
        if (!number) return "";
        if (i > 0) steps.push_back(*number - *parse_stem(stems[i - 1]));
    }
    if (steps.empty()) return "";
    const int smallest = std::ranges::min(steps);
    const auto find_step = [&](const auto& test) {
        return std::size_t(std::ranges::find_if(steps, test) - steps.begin());
    };
    if (smallest <= 0) {
        const std::size_t i = find_step([](int step) { return step <= 0; });
        return fmt::format(
            "the scans are sorted by name, so {} is before {}, because the numbers have no leading zeros",
            stems[i], stems[i + 1]);
    }
    const std::size_t i = find_step([&](int step) { return double(step) >= kMissingScan * smallest; });
    return i == steps.size() ? ""
                             : fmt::format("no scan was found between {} and {}", stems[i], stems[i + 1]);
}

/// Returns notes for the user if LiDARs have missing scans, or unequal numbers of scans.
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

/// Reads the keys that describe the values in scan files.
PointFileUnits read_units(const JsonField& root) {
    PointFileUnits units;
    units.columns = read_text_list(root, "columns");
    if (units.columns.size() > kMostFieldsOfPoint)
        root.at("columns").reject(fmt::format("found {} names", units.columns.size()),
                                  fmt::format("expected at most {} names", kMostFieldsOfPoint));
    if (root.has_member("intensity_max"))
        units.intensity_max = root.at("intensity_max").number_in(1e-12, kMaxHeaderNumber);
    const std::map<std::string, double> seconds = {{"s", 1.0}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}};
    if (root.has_member("time_unit"))
        units.time_unit_s = seconds.at(read_word(root.at("time_unit"), {"s", "ms", "us", "ns"}));
    units.is_unit_open = !root.has_member("time_unit");
    units.is_reference_open = !root.has_member("point_times");
    units.absolute_times = root.has_member("point_times") &&
                           read_word(root.at("point_times"), {"offsets", "absolute"}) == "absolute";
    return units;
}

/// Reads the frames: either the list "frames", or the files in the scan folders at the
/// constant rate "rate_hz". Sorts them by time. Adds notes about missing scans.
void read_frames(FolderHead& header, const JsonField& root, const fs::path& folder) {
    const bool has_list = root.has_member("frames"), has_rate = root.has_member("rate_hz");
    if (has_list == has_rate)
        root.reject(
            has_list ? "found both \"frames\" and \"rate_hz\"" : "found neither \"frames\" nor \"rate_hz\"",
            "expected exactly one of the two keys");
    if (has_list) {
        header.frames = read_frame_list(root.at("frames"), header.lidars, folder);
    } else {
        const double rate_hz = root.at("rate_hz").number_in(1e-3, 1e3);
        header.frames = list_folder_frames(rate_hz, header.lidars, folder);
        std::ranges::copy(note_missing_scans(header.frames, header.lidars), std::back_inserter(header.notes));
    }
    std::ranges::stable_sort(header.frames, {},
                             [](const LogFrame& frame) { return std::pair(frame.time_s, frame.lidar); });
}

/// Adds a note that names the columns that relidar ignores.
void note_skipped_columns(FolderHead& header) {
    std::vector<std::string> skipped;
    std::ranges::copy_if(header.units.columns, std::back_inserter(skipped),
                         [](const std::string& column) { return !is_known_field(column); });
    if (!skipped.empty())
        header.notes.push_back(
            fmt::format("these columns of the scans are not read: {}", fmt::join(skipped, ", ")));
}

/// Reads where the world frame of the log is on the earth.
void read_place(FolderHead& header, const JsonField& root) {
    if (root.has_member("georeference")) {
        header.georeference = read_georeference(root.at("georeference"));
        if (has_proj()) {  // The converter rejects unsuitable projections.
            const std::string note = GeoConverter(*header.georeference).scale_note();
            if (!note.empty()) header.notes.push_back({"map_scale", -1, note});
        }
    }
    if (root.has_member("world_offset_m")) {
        const JsonField offset = root.at("world_offset_m");
        const auto v = offset.numbers<3>();
        for (std::size_t i = 0; i < 3; ++i) offset.at(i).number_in(-kFarthestWorld_m, kFarthestWorld_m);
        header.world_offset_m = glm::dvec3(v[0], v[1], v[2]);
    }
}

}  // namespace

FolderHead read_header(const fs::path& folder, double default_max_range_m) {
    const std::string file = (folder / kHeadFile).string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    root.check_members({"format", "version", "relidar", "name", "conventions", "notes", "lidars", "frames",
                        "rate_hz", "motion_compensated", "columns", "intensity_max", "time_unit",
                        "point_times", "world_offset_m", "georeference", "start_unix_ns",
                        "labelled_azimuth_rad"});
    if (root.at("format").text() != kLogFormat)
        root.at("format").reject("found another format", fmt::format("expected \"{}\"", kLogFormat));
    root.at("version").integer_in(1, kLogVersion);
    FolderHead header;
    header.name = read_text_or(root, "name", folder.filename().string());
    header.conventions =
        read_text_or(root, "conventions", "Sensor frame: x forward, y left, z up, in metres.", kLongestText);
    std::ranges::copy(read_text_list(root, "notes"), std::back_inserter(header.notes));
    if (root.has_member("start_unix_ns"))
        header.start_unix_ns = root.at("start_unix_ns").integer_in(0, kLatestLogStart_ns);
    if (root.has_member("labelled_azimuth_rad"))
        header.labelled_azimuth = read_azimuths(root.at("labelled_azimuth_rad"));
    header.lidars = read_lidars(root, file, folder, default_max_range_m);
    read_frames(header, root, folder);
    header.motion_compensated = read_flag_or(root, "motion_compensated", false);
    header.units = read_units(root);
    note_skipped_columns(header);
    read_place(header, root);
    return header;
}

}  // namespace relidar::read
