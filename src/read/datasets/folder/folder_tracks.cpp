// SPDX-License-Identifier: Apache-2.0
// Reads poses.txt and boxes.json of a plain folder. A plain folder is relidar's log
// format.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/sequence/match_sweeps.hpp"
#include "read/kitti/log_files.hpp"
#include "read/scans/folder_head.hpp"
#include "read/scans/pose_conventions.hpp"

namespace relidar::read {
namespace {

namespace fs = std::filesystem;

// With more scans between two poses, the unit of the times is probably wrong.
constexpr double kMostScansPerPose = 20.0;
// Frames may be this much outside the times of the poses, about one sweep.
constexpr double kMostBeyond_s = 0.1;
constexpr double kMaxTrackValue = 1e12;        // maximum value of all lengths and times
constexpr double kUnitLengthTolerance = 1e-3;  // tolerance of a quaternion's length

const std::vector<std::string> kPoseNames{"time_s", "x", "y", "z", "qw", "qx", "qy", "qz"};

std::string_view strip_comment(const std::string& line) {
    return trim(std::string_view(line).substr(0, line.find('#')));
}

std::vector<std::string_view> split_at_spaces(std::string_view line) {
    std::vector<std::string_view> words;
    for (line = trim(line); !line.empty(); line = trim(line)) {
        const std::size_t end = std::min(line.find_first_of(" \t"), line.size());
        words.push_back(line.substr(0, end));
        line.remove_prefix(end);
    }
    return words;
}

/// Column names are in a comment that contains "qw", or in a line whose first word is not
/// a number.
bool is_header_line(const std::string& line) {
    const std::vector<std::string_view> words =
        split_at_spaces(trim(line).substr(trim(line).starts_with('#') ? 1 : 0));
    if (strip_comment(line).empty()) return std::find(words.begin(), words.end(), "qw") != words.end();
    return !words.empty() && !parse_number(words[0]);
}

/// Returns the column index of each name in kPoseNames. Accepts the names of the TUM
/// format, too.
std::vector<int> pose_columns(const std::string& header_line, const std::string& place) {
    std::vector<std::string_view> words =
        split_at_spaces(trim(header_line).substr(trim(header_line).starts_with('#') ? 1 : 0));
    for (std::string_view& word : words) {
        if (word == "timestamp" || word == "time") word = "time_s";
        if (word == "tx" || word == "ty" || word == "tz") word.remove_prefix(1);
    }
    const std::vector<int> at = find_columns(words, kPoseNames, place);
    for (std::size_t c = 0; c < at.size(); ++c)
        if (at[c] < 0) fail("{}: the column '{}' is missing", place, kPoseNames[c]);
    return at;
}

/// A row has a time, a position, and a quaternion or three angles.
struct PoseRows {
    std::vector<std::vector<double>> rows;
    bool has_names = false;  ///< true if a line with column names defines the order of the columns
};

/// Parses the numbers in a line.
/// @param expected_count_or_zero  expected number of values; 0 means 7 or 8
std::vector<double> parse_pose_row(const std::string& line, std::size_t expected_count_or_zero,
                                   const std::string& place) {
    const auto v = parse_numbers(strip_comment(line));
    if (!v ||
        (expected_count_or_zero > 0 ? v->size() != expected_count_or_zero : v->size() != 7 && v->size() != 8))
        fail("{}: found '{}', expected 8 numbers: time_s x y z qw qx qy qz", place, quote(line));
    if (!std::all_of(v->begin(), v->end(), [](double value) { return std::abs(value) <= kMaxTrackValue; }))
        fail("{}: found '{}', expected finite numbers of at most {}{}", place, quote(line), kMaxTrackValue,
             v->front() > kMaxTrackValue ? ", and a time in seconds" : "");
    return *v;
}

/// Throws if the poses have no times. Otherwise x y z and a quaternion would be read as a
/// time, a position and three angles.
void require_row_times(const PoseRows& pose_rows, const std::string& name) {
    const auto ends_with_quaternion = [](const std::vector<double>& row) {
        return row.size() == 7 && std::abs(glm::length(glm::dquat(row[3], row[4], row[5], row[6])) - 1.0) <=
                                      kUnitLengthTolerance;
    };
    if (!pose_rows.rows.empty() && std::ranges::all_of(pose_rows.rows, ends_with_quaternion))
        fail(
            "{}: the poses have no times, because each line has seven numbers and the last four are a "
            "quaternion; expected 8 numbers: time_s x y z qw qx qy qz",
            name);
}

/// Parses all poses of a file. Sorts the columns of each row in the order of kPoseNames.
PoseRows parse_pose_rows(const std::vector<std::string>& lines, const std::string& name) {
    PoseRows rows;
    std::vector<int> at;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        const std::string where = fmt::format("{} line {}", name, i + 1);
        if (rows.rows.empty() && is_header_line(lines[i])) {
            at = pose_columns(lines[i], where);
            rows.has_names = true;
            continue;
        }
        if (strip_comment(lines[i]).empty()) continue;
        std::size_t expected_count_or_zero = at.size();
        if (at.empty() && !rows.rows.empty()) expected_count_or_zero = rows.rows[0].size();
        std::vector<double> row = parse_pose_row(lines[i], expected_count_or_zero, where);
        if (const std::vector<double> read = row; !at.empty())
            for (std::size_t c = 0; c < row.size(); ++c) row[c] = read[std::size_t(at[c])];
        if (!rows.rows.empty() && !(row[0] > rows.rows.back()[0]))
            fail("{}: found the time {} s after {} s, expected increasing times", where, row[0],
                 rows.rows.back()[0]);
        if (row.size() == 8) {
            const double length = glm::length(glm::dquat(row[4], row[5], row[6], row[7]));
            if (!(std::abs(length - 1.0) <= kUnitLengthTolerance))
                fail("{}: found a quaternion of length {}, expected length 1", where, length);
        }
        rows.rows.push_back(std::move(row));
    }
    require_row_times(rows, name);
    return rows;
}

template <class RotationOf>
PoseTrack make_row_track(const PoseRows& pose_rows, const RotationOf& rotation_of_row) {
    PoseTrack track;
    for (const std::vector<double>& row : pose_rows.rows)
        track.append(row[0], {glm::normalize(rotation_of_row(row)), {row[1], row[2], row[3]}});
    return track;
}

/// Adds the inverse poses to a list of possible meanings, because a pose file may contain
/// sensor-from-world poses.
std::vector<PoseReading> add_inverses(std::vector<PoseReading> interpretations) {
    const std::size_t n = interpretations.size();
    for (std::size_t k = 0; k < n; ++k) {
        PoseTrack track = interpretations[k].world_from_vehicle;
        for (Pose& pose : track.pose) pose = inverse(pose);
        interpretations.push_back(
            {interpretations[k].about + ", from the world to the sensor", std::move(track), true});
    }
    return interpretations;
}

/// Returns all meanings of the numbers, such as another order of the quaternion. The
/// documented one is first.
std::vector<PoseReading> list_conventions(const PoseRows& pose_rows) {
    using Row = std::vector<double>;
    const auto angles = [](const Row& row, double unit) {
        return make_rotation(unit * row[6], unit * row[5], unit * row[4]);
    };
    std::vector<PoseReading> readings;
    if (pose_rows.rows[0].size() == 8) {
        const std::string named = "columns in the order of the header line";
        readings.push_back(
            {pose_rows.has_names ? named : kScalarFirst,
             make_row_track(pose_rows, [](const Row& r) { return glm::dquat(r[4], r[5], r[6], r[7]); })});
        if (!pose_rows.has_names)
            readings.push_back({kScalarLast, make_row_track(pose_rows, [](const Row& r) {
                                    return glm::dquat(r[7], r[4], r[5], r[6]);
                                })});
    } else {
        readings.push_back({"roll, pitch and yaw in radians",
                            make_row_track(pose_rows, [&](const Row& r) { return angles(r, 1.0); })});
        readings.push_back({"roll, pitch and yaw in degrees",
                            make_row_track(pose_rows, [&](const Row& r) { return angles(r, kPi / 180.0); })});
    }
    return add_inverses(std::move(readings));
}

/// Returns a hint why poses do not cover the frames: times in another unit, leap seconds,
/// or another clock.
std::string clock_hint(const PoseTrack& track, const std::vector<LogFrame>& frames, bool is_plain_folder) {
    // maximum relative difference of equal times or durations in different units
    constexpr double kMaxRelativeDifference = 0.3;
    const double pose_span_s = track.time_s.back() - track.time_s.front(),
                 frame_span_s = frames.back().time_s - frames.front().time_s;
    double per_second = 1.0;
    for (const char* unit : {"milliseconds", "microseconds", "nanoseconds"}) {
        per_second *= 1000.0;
        const auto is_longer = [&](double longer_s, double shorter_s) {
            return shorter_s > 0.0 &&
                   std::abs(longer_s / per_second / shorter_s - 1.0) < kMaxRelativeDifference;
        };
        const bool is_pose = is_longer(pose_span_s, frame_span_s);
        if (is_pose || is_longer(frame_span_s, pose_span_s))
            return fmt::format("; the times of the {} seem to be in {}, expected seconds",
                               is_pose ? "poses" : "frames", unit);
    }
    // Clocks without leap seconds differ from UTC or from each other by these constants.
    for (const auto& [leap_s, cause] :
         {std::pair(37, "TAI minus UTC"), {18, "GPS time minus UTC"}, {19, "TAI minus GPS time"}})
        for (const int shift_s : {leap_s, -leap_s})
            if (frames.front().time_s >= track.time_s.front() - shift_s - kMostBeyond_s &&
                frames.back().time_s <= track.time_s.back() - shift_s + kMostBeyond_s)
                return fmt::format("; {} s {}, they would cover all frames ({} is {} s)", leap_s,
                                   shift_s > 0 ? "earlier" : "later", cause, leap_s);
    if (std::ranges::any_of(frames, [&](const auto& f) { return track.contains_time(f.time_s); })) return "";
    if (!is_plain_folder)
        return fmt::format(
            "; poses and frames must have the same clock: correct the times of the poses by the difference "
            "of the clocks, for example {:+.3f} s if both begin simultaneously",
            frames.front().time_s - track.time_s.front());
    return "; poses and frames must have the same clock: write the times of the scans to the key \"frames\" "
           "of sequence.json instead of \"rate_hz\", with which the first scan has the time 0, or subtract "
           "the time of the first scan from the times of the poses";
}

/// Interpolates the poses at the frames, which may be slightly outside the track.
std::vector<Pose> poses_at_frames(const PoseTrack& track, const std::vector<LogFrame>& frames,
                                  const std::string& name, bool is_plain_folder) {
    std::vector<Pose> poses;
    for (const LogFrame& frame : frames) {
        if (frame.time_s < track.time_s.front() - kMostBeyond_s ||
            frame.time_s > track.time_s.back() + kMostBeyond_s)
            fail("{}: found poses from {} to {} s, but frame {} is at {} s, expected poses for all frames{}",
                 name, track.time_s.front(), track.time_s.back(), frame.number, frame.time_s,
                 clock_hint(track, frames, is_plain_folder));
        poses.push_back(track.pose_at(frame.time_s));
    }
    return poses;
}

/// Notes poses that are much farther apart than the scans, usually because of a wrong
/// unit.
void note_sparse_poses(const PoseTrack& track, const std::vector<LogFrame>& frames, const std::string& name,
                       Notes& notes) {
    std::vector<double> times_s;
    for (const LogFrame& frame : frames)
        if (frame.lidar == frames.front().lidar) times_s.push_back(frame.time_s);
    if (track.time_s.size() < 2 || times_s.size() < 2) return;
    const double pose_step_s = median_interval_s(track.time_s), frame_step_s = median_interval_s(times_s);
    if (pose_step_s > kMostScansPerPose * frame_step_s)
        notes.push_back(
            fmt::format("{}: poses are {:.3g} s apart, but scans are {:.3g} s apart, and poses in between "
                        "are interpolated; check the unit of the times",
                        name, pose_step_s, frame_step_s));
}

double label_time_s(const JsonField& label, const std::vector<LogFrame>& all_frames) {
    if (label.has_member("time_s")) return label.at("time_s").number_in(-kMaxTrackValue, kMaxTrackValue);
    const std::int64_t number = label.at("frame").integer_in(0, 99999999);
    const auto frame = std::find_if(all_frames.begin(), all_frames.end(),
                                    [&](const LogFrame& f) { return f.number == number; });
    if (frame == all_frames.end())
        label.at("frame").reject(fmt::format("found frame {}", number),
                                 "expected the number of a frame of the log");
    return frame->time_s;
}

Pose read_label_pose(const JsonField& label) {
    const auto p = label.at("position").numbers<3>();
    const glm::dvec3 position(p[0], p[1], p[2]);
    if (label.has_member("yaw_deg") && label.has_member("quaternion"))
        label.reject("found both \"yaw_deg\" and \"quaternion\"", "expected one of the two keys");
    if (label.has_member("yaw_deg"))
        return {glm::angleAxis(label.at("yaw_deg").number_in(-1e6, 1e6) * kPi / 180.0, glm::dvec3(0, 0, 1)),
                position};
    // in the order w, x, y, z
    const auto q = label.at("quaternion").numbers<4>();
    // check_sequence() checks the quaternion's length
    return {glm::dquat(q[0], q[1], q[2], q[3]), position};
}

BoxLabel read_box_label(const JsonField& label, const std::vector<LogFrame>& all_frames) {
    label.check_members(
        {"track", "category", "time_s", "frame", "size", "position", "yaw_deg", "quaternion"});
    const auto size = label.at("size").numbers<3>();
    return {label.at("track").short_text(kLongestName),
            label.at("category").short_text(kLongestName),
            {size[0], size[1], size[2]},
            label_time_s(label, all_frames),
            read_label_pose(label)};
}

}  // namespace

std::optional<std::vector<Pose>> load_poses(const fs::path& pose_file, const std::vector<LogFrame>& frames,
                                            const ScanPairReader& read_scan_pairs_for_pose_check,
                                            Notes& notes) {
    if (!does_path_exist(pose_file)) return std::nullopt;
    std::vector<std::string> lines = split_lines(read_text_file(pose_file));
    for (std::string& line : lines) std::ranges::replace(line, ',', ' ');
    const auto first = std::find_if(lines.begin(), lines.end(),
                                    [](const std::string& line) { return !strip_comment(line).empty(); });
    if (first == lines.end())
        fail("{}: the file has no pose, expected lines of 12 or 8 numbers", pose_file.string());
    if (split_at_spaces(strip_comment(*first)).size() != 12) {
        const PoseRows rows = parse_pose_rows(lines, pose_file.string());
        if (rows.rows.empty())
            fail("{}: the file has no pose, expected lines of 12 or 8 numbers", pose_file.string());
        const std::vector<PoseReading> readings = list_conventions(rows);
        // Only relidar writes these column names. The meaning of the numbers is therefore
        // certain.
        const bool is_certain = rows.has_names && lines[0].find(kPoseNames[0]) != std::string::npos;
        const std::size_t k =
            is_certain ? 0
                       : choose_poses(readings, read_scan_pairs_for_pose_check, pose_file.string(), notes);
        note_sparse_poses(readings[k].world_from_vehicle, frames, pose_file.string(), notes);
        // Only plain folders give pairs of scans.
        return poses_at_frames(readings[k].world_from_vehicle, frames, pose_file.string(),
                               bool(read_scan_pairs_for_pose_check));
    }
    std::vector<int> numbers;
    for (const LogFrame& frame : frames) numbers.push_back(frame.number);
    std::vector<Pose> poses = kitti::read_matrices(pose_file, numbers);
    PoseTrack track;  // one pose per time; LiDARs of the same sweep share a pose
    for (std::size_t i = 0; i < frames.size(); ++i)
        if (track.time_s.empty() || frames[i].time_s != track.time_s.back())
            track.append(frames[i].time_s, poses[i]);
    const std::vector<PoseReading> readings = add_inverses({{"matrices", std::move(track)}});
    if (choose_poses(readings, read_scan_pairs_for_pose_check, pose_file.string(), notes) > 0)
        for (Pose& pose : poses) pose = inverse(pose);
    return poses;
}

std::vector<BoxTrack> read_box_tracks(const fs::path& path, const std::vector<LogFrame>& loaded_frames,
                                      const std::vector<LogFrame>& all_frames) {
    if (!does_path_exist(path)) return {};
    const std::string file = path.string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    root.check_members({"boxes"});
    const JsonField boxes = root.at("boxes");
    const double first_s = loaded_frames.front().time_s, last_s = loaded_frames.back().time_s;
    // At the ends of the log, labels outside the times of the frames count too.
    const bool from_start = first_s == all_frames.front().time_s, to_end = last_s == all_frames.back().time_s;
    std::vector<BoxLabel> labels;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const BoxLabel label = read_box_label(boxes.at(i), all_frames);
        if ((from_start || label.time_s >= first_s) && (to_end || label.time_s <= last_s))
            labels.push_back(label);
    }
    return build_tracks(labels);
}

}  // namespace relidar::read
