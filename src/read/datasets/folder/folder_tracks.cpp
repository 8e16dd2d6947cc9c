// SPDX-License-Identifier: Apache-2.0
// Reads poses.txt and boxes.json of a plain folder, which is relidar's log format.
#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>

#include "base/csv.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/frames/match_sweeps.hpp"
#include "read/files/point_table.hpp"
#include "read/scans/folder_head.hpp"
#include "read/scans/pose_conventions.hpp"
#include "read/scans/pose_files.hpp"

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

/// Returns the words of a line, also if the line is a comment.
std::vector<std::string_view> split_header(const std::string& line) {
    std::string_view text = trim(line);
    if (text.starts_with('#')) text.remove_prefix(1);
    return split_words(text);
}

/// A header is a comment that contains "qw", or a line whose first word is no number.
bool is_header_line(const std::string& line) {
    const std::vector<std::string_view> words = split_header(line);
    if (strip_comment(line).empty()) return std::find(words.begin(), words.end(), "qw") != words.end();
    return !words.empty() && !parse_number(words[0]);
}

/// Reads the line with the column names of a pose file. Returns the column index of each
/// name in kPoseNames (time_s x y z qw qx qy qz), which can be in any order. Also accepts
/// the names of the TUM format: timestamp tx ty tz.
std::vector<int> pose_columns(const std::string& header_line, const std::string& place) {
    std::vector<std::string_view> names = split_header(header_line);
    for (std::string_view& name : names) {
        if (name == "timestamp" || name == "time") name = "time_s";
        if (name == "tx" || name == "ty" || name == "tz") name.remove_prefix(1);
    }
    const std::vector<int> column_of = find_columns(names, kPoseNames, place);
    for (std::size_t k = 0; k < column_of.size(); ++k)
        if (column_of[k] < 0) fail("{}: the column '{}' is missing", place, kPoseNames[k]);
    return column_of;
}

/// A row has a time, a position, and a quaternion or three angles.
struct PoseRows {
    std::vector<std::vector<double>> rows;
    bool has_names = false;  ///< true if a line with column names defines the order of the columns
};

bool is_unit_quaternion(double w, double x, double y, double z) {
    return std::abs(glm::length(glm::dquat(w, x, y, z)) - 1.0) <= kUnitLengthTolerance;
}

/// Parses the numbers of one pose: a time, a position, and a quaternion (8 numbers) or
/// three angles (7 numbers). The messages name only 8 numbers, the documented form.
/// @param expected_count  number of values in the earlier rows, which all rows must have
std::vector<double> parse_pose_row(const std::string& line, std::optional<std::size_t> expected_count,
                                   const std::string& place) {
    const auto row = parse_numbers(strip_comment(line));
    const std::size_t n = row ? row->size() : 0;
    const bool is_known_count = expected_count ? n == *expected_count : n == 7 || n == 8;
    if (!row || !is_known_count)
        fail("{}: found '{}', expected 8 numbers: time_s x y z qw qx qy qz", place, quote(line));
    if (!std::ranges::all_of(*row, [](double value) { return std::abs(value) <= kMaxTrackValue; }))
        fail("{}: found '{}', expected finite numbers of at most {}{}", place, quote(line), kMaxTrackValue,
             row->front() > kMaxTrackValue ? ", and a time in seconds" : "");
    return *row;
}

/// Throws if the poses have no times: 7 numbers could be a time, a position and three
/// angles, or a position and a quaternion. If the last four numbers of all rows have
/// length 1, they are a quaternion.
void require_row_times(const PoseRows& pose_rows, const std::string& name) {
    const auto ends_with_quaternion = [](const std::vector<double>& row) {
        return row.size() == 7 && is_unit_quaternion(row[3], row[4], row[5], row[6]);
    };
    if (!pose_rows.rows.empty() && std::ranges::all_of(pose_rows.rows, ends_with_quaternion))
        fail(
            "{}: the poses have no times, because each line has seven numbers and the last four are a "
            "quaternion; expected 8 numbers: time_s x y z qw qx qy qz",
            name);
}

/// Checks that a row is later than the row before it, and that a quaternion has length 1.
void check_pose_row(const std::vector<double>& row, const PoseRows& earlier, const std::string& where) {
    if (!earlier.rows.empty() && !(row[0] > earlier.rows.back()[0]))
        fail("{}: found the time {} s after {} s, expected increasing times", where, row[0],
             earlier.rows.back()[0]);
    if (row.size() == 8 && !is_unit_quaternion(row[4], row[5], row[6], row[7]))
        fail("{}: found a quaternion of length {}, expected length 1", where,
             glm::length(glm::dquat(row[4], row[5], row[6], row[7])));
}

/// Parses all poses of a file, except their meaning. If a line names the columns, the
/// values of each row are sorted in the order of kPoseNames.
PoseRows parse_pose_rows(const std::vector<std::string>& lines, const std::string& name) {
    PoseRows result;
    std::vector<int> column_of;  // [kPoseNames] column in the file; empty without names
    std::optional<std::size_t> expected_count;
    for (std::size_t i = 0; i < lines.size(); ++i) {
        const std::string where = fmt::format("{} line {}", name, i + 1);
        if (result.rows.empty() && is_header_line(lines[i])) {
            column_of = pose_columns(lines[i], where);
            expected_count = column_of.size();
            result.has_names = true;
            continue;
        }
        if (strip_comment(lines[i]).empty()) continue;

        const std::vector<double> values = parse_pose_row(lines[i], expected_count, where);
        expected_count = values.size();
        std::vector<double> row = values;
        for (std::size_t k = 0; k < column_of.size(); ++k) row[k] = values[std::size_t(column_of[k])];
        check_pose_row(row, result, where);
        result.rows.push_back(std::move(row));
    }
    require_row_times(result, name);
    return result;
}

/// Makes a track of the rows.
/// @param rotation_of_row  computes the rotation from the numbers after the position
template <class RotationOf>
PoseTrack make_row_track(const PoseRows& pose_rows, const RotationOf& rotation_of_row) {
    PoseTrack track;
    for (const std::vector<double>& row : pose_rows.rows)
        track.append(row[0], {glm::normalize(rotation_of_row(row)), {row[1], row[2], row[3]}});
    return track;
}

/// Adds the inverse poses to a list of meanings, for files with sensor-from-world poses.
std::vector<PoseReading> add_inverses(std::vector<PoseReading> interpretations) {
    const std::size_t n = interpretations.size();
    for (std::size_t k = 0; k < n; ++k) {
        PoseReading inverted = interpretations[k];
        inverted.name += ", from the world to the sensor";
        inverted.needs_scans = true;
        for (Pose& pose : inverted.world_from_vehicle.pose) pose = inverse(pose);
        interpretations.push_back(std::move(inverted));
    }
    return interpretations;
}

/// Returns all plausible meanings of the numbers in a pose file: other orders of the
/// quaternion, degrees instead of radians, and inverse poses. The documented meaning is
/// first. The caller tests which one fits the scans.
std::vector<PoseReading> list_conventions(const PoseRows& pose_rows) {
    using Row = std::vector<double>;  // time, x, y, z, and four or three numbers of the rotation
    const auto w_first = [](const Row& row) { return glm::dquat(row[4], row[5], row[6], row[7]); };
    const auto w_last = [](const Row& row) { return glm::dquat(row[7], row[4], row[5], row[6]); };
    const auto radians = [](const Row& row) { return make_rotation(row[6], row[5], row[4]); };
    const auto degrees = [](const Row& row) {
        constexpr double kDegree = kPi / 180.0;
        return make_rotation(kDegree * row[6], kDegree * row[5], kDegree * row[4]);
    };
    const bool has_quaternions = pose_rows.rows[0].size() == 8;
    std::vector<PoseReading> readings;
    if (has_quaternions && pose_rows.has_names)
        readings = {{"columns in the order of the header line", make_row_track(pose_rows, w_first)}};
    else if (has_quaternions)
        readings = {{.name = kScalarFirst,
                     .world_from_vehicle = make_row_track(pose_rows, w_first),
                     .quaternions = Conventions::Quaternions::wxyz},
                    {.name = kScalarLast,
                     .world_from_vehicle = make_row_track(pose_rows, w_last),
                     .quaternions = Conventions::Quaternions::xyzw}};
    else
        readings = {{.name = "roll, pitch and yaw in radians",
                     .world_from_vehicle = make_row_track(pose_rows, radians),
                     .angles = Conventions::Angles::radians},
                    {.name = "roll, pitch and yaw in degrees",
                     .world_from_vehicle = make_row_track(pose_rows, degrees),
                     .angles = Conventions::Angles::degrees}};
    return add_inverses(std::move(readings));
}

/// Returns a hint if the poses last about 1000, 10^6 or 10^9 times as long as the frames,
/// or the reverse, because one file then has another unit. Otherwise returns "".
std::string unit_hint(double pose_span_s, double frame_span_s) {
    // The poses may begin earlier or end later than the frames.
    constexpr double kMaxRelativeDifference = 0.3;
    double factor = 1.0;
    for (const char* unit : {"milliseconds", "microseconds", "nanoseconds"}) {
        factor *= 1000.0;
        const auto is_longer = [&](double longer_s, double shorter_s) {
            return shorter_s > 0.0 && std::abs(longer_s / factor / shorter_s - 1.0) < kMaxRelativeDifference;
        };
        const bool are_poses_longer = is_longer(pose_span_s, frame_span_s);
        if (are_poses_longer || is_longer(frame_span_s, pose_span_s))
            return fmt::format("; the times of the {} seem to be in {}, expected seconds",
                               are_poses_longer ? "poses" : "frames", unit);
    }
    return "";
}

/// Returns a hint if the poses would cover all frames after a shift by the difference of
/// two common clocks, such as GPS time and UTC. Otherwise returns "".
std::string leap_second_hint(const PoseTrack& track, const std::vector<LogFrame>& frames, double set_s) {
    // These clocks differ by a constant number of seconds, because only UTC has leap
    // seconds and the others began in different years.
    constexpr std::pair<int, const char*> kDifferences[] = {
        {37, "TAI minus UTC"}, {18, "GPS time minus UTC"}, {19, "TAI minus GPS time"}};
    for (const auto& [difference_s, name] : kDifferences)
        for (const int earlier_s : {difference_s, -difference_s}) {  // subtracted from pose times
            const double begin_s = track.time_s.front() - earlier_s - kMostBeyond_s,
                         end_s = track.time_s.back() - earlier_s + kMostBeyond_s;
            if (frames.front().time_s >= begin_s && frames.back().time_s <= end_s)
                return fmt::format(
                    "; {} s {}, they would cover all frames ({} is {} s); set "
                    "conventions.clock_offset_s={:g}",
                    difference_s, earlier_s > 0 ? "earlier" : "later", name, difference_s, set_s - earlier_s);
        }
    return "";
}

/// Returns a hint for the user why poses do not cover the frames: times in another unit,
/// leap seconds, or (if they cover no frame) another clock. May return an empty string.
/// @param set_s  clock offset that the times of the poses already contain
/// @param is_plain_folder  if true, the advice names keys of sequence.json
std::string clock_hint(const PoseTrack& track, const std::vector<LogFrame>& frames, double set_s,
                       bool is_plain_folder) {
    std::string hint =
        unit_hint(track.time_s.back() - track.time_s.front(), frames.back().time_s - frames.front().time_s);
    if (hint.empty()) hint = leap_second_hint(track, frames, set_s);
    if (!hint.empty()) return hint;
    const auto is_covered = [&](const LogFrame& frame) { return track.contains_time(frame.time_s); };
    if (std::ranges::any_of(frames, is_covered)) return "";
    if (!is_plain_folder)
        return fmt::format(
            "; poses and frames must have the same clock: set conventions.clock_offset_s to the difference "
            "of "
            "the clocks, for example {:.3f} if both begin simultaneously",
            frames.front().time_s - track.time_s.front() + set_s);
    return "; poses and frames must have the same clock: write the times of the scans to the key \"frames\" "
           "of sequence.json instead of \"rate_hz\", with which the first scan has the time 0, or subtract "
           "the time of the first scan from the times of the poses";
}

/// Interpolates the poses at the times of the frames, which may be at most kMostBeyond_s
/// outside the track.
/// @throws DataError with a hint about the cause for a frame farther outside
std::vector<Pose> poses_at_frames(const PoseTrack& track, const std::vector<LogFrame>& frames,
                                  const std::string& name, double set_s, bool is_plain_folder) {
    std::vector<Pose> poses;
    for (const LogFrame& frame : frames) {
        if (frame.time_s < track.time_s.front() - kMostBeyond_s ||
            frame.time_s > track.time_s.back() + kMostBeyond_s)
            fail("{}: found poses from {} to {} s, but frame {} is at {} s, expected poses for all frames{}",
                 name, track.time_s.front(), track.time_s.back(), frame.number, frame.time_s,
                 clock_hint(track, frames, set_s, is_plain_folder));
        poses.push_back(track.pose_at(frame.time_s));
    }
    return poses;
}

/// Adds a note if poses are much farther apart than scans, as with a wrong unit of times.
void note_sparse_poses(const PoseTrack& track, const std::vector<LogFrame>& frames, const std::string& name,
                       Notes& notes) {
    std::vector<double> scan_times_s;  // of one LiDAR, because LiDARs can sweep simultaneously
    for (const LogFrame& frame : frames)
        if (frame.lidar == frames.front().lidar) scan_times_s.push_back(frame.time_s);
    if (track.time_s.size() < 2 || scan_times_s.size() < 2) return;
    const double pose_step_s = median_interval_s(track.time_s),
                 frame_step_s = median_interval_s(scan_times_s);
    if (pose_step_s > kMostScansPerPose * frame_step_s)
        notes.push_back(
            fmt::format("{}: poses are {:.3g} s apart, but scans are {:.3g} s apart, and poses in between "
                        "are interpolated; check the unit of the times",
                        name, pose_step_s, frame_step_s));
}

/// Returns the time of a box label: its key "time_s", or the time of the frame "frame".
double label_time_s(const JsonField& label, const std::vector<LogFrame>& all_frames) {
    if (label.has_member("time_s")) return label.at("time_s").number_in(-kMaxTrackValue, kMaxTrackValue);
    const std::int64_t number = label.at("frame").integer_in(0, 99999999);
    const auto frame = std::ranges::find(all_frames, number, &LogFrame::number);
    if (frame == all_frames.end())
        label.at("frame").reject(fmt::format("found frame {}", number),
                                 "expected the number of a frame of the log");
    return frame->time_s;
}

/// Reads the pose world_from_box of a label: the position of the box centre in metres,
/// and the rotation as an angle about z or as a quaternion w x y z.
Pose read_label_pose(const JsonField& label) {
    const auto p = label.at("position").numbers<3>();
    const glm::dvec3 position(p[0], p[1], p[2]);
    if (label.has_member("yaw_deg") && label.has_member("quaternion"))
        label.reject("found both \"yaw_deg\" and \"quaternion\"", "expected one of the two keys");
    if (label.has_member("yaw_deg"))
        return {glm::angleAxis(label.at("yaw_deg").number_in(-1e6, 1e6) * kPi / 180.0, glm::dvec3(0, 0, 1)),
                position};
    const auto q = label.at("quaternion").numbers<4>();
    // check_log() checks the length of the quaternion later, for all datasets.
    return {glm::dquat(q[0], q[1], q[2], q[3]), position};
}

/// Reads one entry of boxes.json: the box of a track at one time.
BoxLabel read_box_label(const JsonField& label, const std::vector<LogFrame>& all_frames) {
    label.check_members(
        {"track", "category", "time_s", "frame", "size", "position", "yaw_deg", "quaternion"});
    const auto size = label.at("size").numbers<3>();
    return {.id = label.at("track").short_text(kLongestName),
            .category = label.at("category").short_text(kLongestName),
            .size_m = {size[0], size[1], size[2]},
            .time_s = label_time_s(label, all_frames),
            .world_from_box = read_label_pose(label)};
}

[[noreturn]] void fail_without_poses(const std::string& file_name) {
    fail("{}: the file has no pose, expected lines of 12 or 8 numbers", file_name);
}

/// Reads poses with their own times, and interpolates them at the frames. Pairs of scans
/// show which meaning of the numbers is correct.
/// @param read_scan_pairs  empty unless the log is a plain folder (with sequence.json)
std::vector<Pose> load_timed_poses(const std::vector<std::string>& lines, const std::string& file_name,
                                   const std::vector<LogFrame>& frames, const ScanPairReader& read_scan_pairs,
                                   const Conventions& set, Log& log) {
    const PoseRows rows = parse_pose_rows(lines, file_name);
    if (rows.rows.empty()) fail_without_poses(file_name);
    std::vector<PoseReading> readings = list_conventions(rows);  // [0]: the documented one
    if (const std::optional<double> offset_s = read_clock_offset_s(set)) {
        for (PoseReading& reading : readings)
            for (double& time_s : reading.world_from_vehicle.time_s) time_s += *offset_s;
        list_convention(
            log, {"clock", describe_clock("scans", *offset_s), kFromSetting, "conventions.clock_offset_s"});
    }
    // Only relidar writes the column name time_s. Its files are as documented.
    const bool is_certain = rows.has_names && lines[0].find(kPoseNames[0]) != std::string::npos;
    if (is_certain) {
        const bool is_inverse = set.poses == Conventions::Poses::sensor_from_world;
        readings = {readings[is_inverse ? readings.size() / 2 : 0]};  // the inverses follow
    }
    const PoseTrack& track =
        readings[choose_poses(readings, read_scan_pairs, file_name, set, log)].world_from_vehicle;
    note_sparse_poses(track, frames, file_name, log.notes);
    return poses_at_frames(track, frames, file_name, read_clock_offset_s(set).value_or(0.0),
                           /*is_plain_folder=*/bool(read_scan_pairs));
}

/// Reads a 3x4 matrix for each frame: line i belongs to frame number i. Inverts the poses
/// if the vehicle then drives forward and the scans overlap better.
/// @param read_scan_pairs  reads scans to test the poses; may be empty
std::vector<Pose> load_matrix_poses(const fs::path& pose_file, const std::vector<LogFrame>& frames,
                                    const ScanPairReader& read_scan_pairs, const Conventions& set, Log& log) {
    std::vector<int> numbers;
    for (const LogFrame& frame : frames) numbers.push_back(frame.number);
    std::vector<Pose> poses = read::read_matrices(pose_file, numbers);
    PoseTrack track;  // one pose per time; LiDARs of the same sweep share a pose
    for (std::size_t i = 0; i < frames.size(); ++i)
        if (track.time_s.empty() || frames[i].time_s != track.time_s.back())
            track.append(frames[i].time_s, poses[i]);
    const std::vector<PoseReading> stored_and_inverse = add_inverses({{"matrices", std::move(track)}});
    const bool is_inverse =
        choose_poses(stored_and_inverse, read_scan_pairs, pose_file.string(), set, log) == 1;
    if (is_inverse)
        for (Pose& pose : poses) pose = inverse(pose);
    return poses;
}

}  // namespace

std::optional<std::vector<Pose>> load_poses(const fs::path& pose_file, const std::vector<LogFrame>& frames,
                                            const ScanPairReader& read_scan_pairs_for_pose_check,
                                            const Conventions& set, Log& log) {
    constexpr std::size_t kMatrixNumbers = 12;
    if (!does_path_exist(pose_file)) return std::nullopt;
    std::vector<std::string> lines = split_lines(read_text_file(pose_file));
    for (std::string& line : lines) std::ranges::replace(line, ',', ' ');
    const auto first =
        std::ranges::find_if(lines, [](const std::string& line) { return !strip_comment(line).empty(); });
    if (first == lines.end()) fail_without_poses(pose_file.string());
    if (split_words(strip_comment(*first)).size() == kMatrixNumbers)
        return load_matrix_poses(pose_file, frames, read_scan_pairs_for_pose_check, set, log);
    return load_timed_poses(lines, pose_file.string(), frames, read_scan_pairs_for_pose_check, set, log);
}

std::vector<BoxTrack> read_box_tracks(const fs::path& path, const std::vector<LogFrame>& loaded_frames,
                                      const std::vector<LogFrame>& all_frames) {
    if (!does_path_exist(path)) return {};
    const std::string file = path.string();
    const nlohmann::json json = parse_json(read_text_file(file), file);
    const JsonField root(json, file, "");
    root.check_members({"boxes"});
    const JsonField boxes = root.at("boxes");
    // Keeps labels in the time of the loaded frames. At the ends of the log, keeps labels
    // before the first and after the last frame, too.
    const double first_s = loaded_frames.front().time_s, last_s = loaded_frames.back().time_s;
    const double begin_s = first_s == all_frames.front().time_s ? -INFINITY : first_s,
                 end_s = last_s == all_frames.back().time_s ? INFINITY : last_s;
    std::vector<BoxLabel> labels;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const BoxLabel label = read_box_label(boxes.at(i), all_frames);
        if (label.time_s >= begin_s && label.time_s <= end_s) labels.push_back(label);
    }
    return build_tracks(labels);
}

}  // namespace relidar::read
