// SPDX-License-Identifier: Apache-2.0
// Reads poses.txt and boxes.json of a plain folder, which is relidar's log format.
#include <algorithm>
#include <array>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>

#include "base/csv.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/clouds/folder_head.hpp"
#include "log/clouds/log_files.hpp"

namespace relidar::folder {
namespace {

namespace fs = std::filesystem;

// Maximum time of a frame before the first pose or after the last pose. It is about one
// sweep.
constexpr double kMostBeyond_s = 0.1;
constexpr double kLargestOfTrack = 1e12;  // limit of all lengths and times
constexpr double kUnit = 1e-3;            // tolerance of a quaternion's length

const std::vector<std::string> kPoseNames{"time_s", "x", "y", "z", "qw", "qx", "qy", "qz"};

/// Returns a line without its comment. A comment begins with '#'.
std::string_view content(const std::string& line) {
    return trimmed(std::string_view(line).substr(0, line.find('#')));
}

std::vector<std::string_view> pose_words(std::string_view text) {
    std::vector<std::string_view> words;
    for (text = trimmed(text); !text.empty(); text = trimmed(text)) {
        const std::size_t end = std::min(text.find_first_of(" \t"), text.size());
        words.push_back(text.substr(0, end));
        text.remove_prefix(end);
    }
    return words;
}

/// Returns true if a line lists the names of the columns. Such a line is a comment that
/// contains "qw", or its first word is not a number.
bool names_columns(const std::string& line) {
    const std::vector<std::string_view> words =
        pose_words(trimmed(line).substr(trimmed(line).starts_with('#') ? 1 : 0));
    if (content(line).empty()) return std::find(words.begin(), words.end(), "qw") != words.end();
    return !words.empty() && !parse_number(words[0]);
}

/// Parses a line with column names. Returns the column index of each name in kPoseNames.
/// Also accepts the names of the TUM format for time and position.
std::vector<int> pose_places(const std::string& line, const std::string& where) {
    std::vector<std::string_view> words =
        pose_words(trimmed(line).substr(trimmed(line).starts_with('#') ? 1 : 0));
    for (std::string_view& word : words) {
        if (word == "timestamp" || word == "time") word = "time_s";
        if (word == "tx" || word == "ty" || word == "tz") word.remove_prefix(1);
    }
    const std::vector<int> at = find_columns(words, kPoseNames, where);
    for (std::size_t c = 0; c < at.size(); ++c)
        if (at[c] < 0)
            throw DataError(fmt::format("{}: found no column '{}', expected it", where, kPoseNames[c]));
    return at;
}

/// Parses a line of numbers. Returns the numbers in the order of kPoseNames.
std::array<double, 8> pose_row(const std::string& line, const std::vector<int>& at,
                               const std::string& where) {
    const auto v = parse_numbers(content(line));
    if (!v || v->size() != at.size())
        throw DataError(
            fmt::format("{}: '{}', expected 8 numbers: time_s x y z qw qx qy qz", where, excerpt(line)));
    if (!std::all_of(v->begin(), v->end(), [](double x) { return std::abs(x) <= kLargestOfTrack; }))
        throw DataError(fmt::format("{}: '{}', expected finite numbers within {}", where, excerpt(line),
                                    kLargestOfTrack));
    std::array<double, 8> row{};
    for (std::size_t c = 0; c < row.size(); ++c) row[c] = (*v)[static_cast<std::size_t>(at[c])];
    return row;
}

PoseTrack read_track(const std::vector<std::string>& lines, const std::string& file) {
    PoseTrack track;
    std::vector<int> at{0, 1, 2, 3, 4, 5, 6, 7};
    for (std::size_t i = 0; i < lines.size(); ++i) {
        const std::string where = fmt::format("{} line {}", file, i + 1);
        if (track.pose.empty() && names_columns(lines[i])) {
            at = pose_places(lines[i], where);
            continue;
        }
        if (content(lines[i]).empty()) continue;
        const auto n = pose_row(lines[i], at, where);
        if (!track.time_s.empty() && !(n[0] > track.time_s.back()))
            throw DataError(fmt::format("{}: time {} s after {} s, expected times that rise", where, n[0],
                                        track.time_s.back()));
        const glm::dquat q(n[4], n[5], n[6], n[7]);
        if (!(std::abs(glm::length(q) - 1.0) <= kUnit))
            throw DataError(fmt::format("{}: a quaternion of length {}, expected 1", where, glm::length(q)));
        track.time_s.push_back(n[0]);
        track.pose.push_back({glm::normalize(q), {n[1], n[2], n[3]}});
    }
    return track;
}

std::vector<Pose> interpolated(const PoseTrack& track, const std::vector<HeadFrame>& frames,
                               const std::string& file) {
    std::vector<Pose> poses;
    for (const HeadFrame& frame : frames) {
        if (frame.time_s < track.time_s.front() - kMostBeyond_s ||
            frame.time_s > track.time_s.back() + kMostBeyond_s)
            throw DataError(fmt::format(
                "{}: poses from {} to {} s, but frame {} is at {} s, expected poses for all frames", file,
                track.time_s.front(), track.time_s.back(), frame.number, frame.time_s));
        poses.push_back(track.at(frame.time_s));
    }
    return poses;
}

double time_of(const JsonField& label, const std::vector<HeadFrame>& all) {
    if (label.has("time_s")) return label.at("time_s").number(-kLargestOfTrack, kLargestOfTrack);
    const std::int64_t number = label.at("frame").integer(0, 99999999);
    const auto frame =
        std::find_if(all.begin(), all.end(), [&](const HeadFrame& f) { return f.number == number; });
    if (frame == all.end())
        label.at("frame").fail(fmt::format("found {}", number), "expected the number of a frame");
    return frame->time_s;
}

Pose pose_of(const JsonField& label) {
    const auto p = label.at("position").numbers<3>();
    const glm::dvec3 position(p[0], p[1], p[2]);
    if (label.has("yaw_deg"))
        return {glm::angleAxis(label.at("yaw_deg").number(-1e6, 1e6) * kPi / 180.0, glm::dvec3(0, 0, 1)),
                position};
    const auto q = label.at("quaternion").numbers<4>();
    // check_sequence() checks the quaternion's length
    return {glm::dquat(q[0], q[1], q[2], q[3]), position};
}

BoxLabel read_label(const JsonField& label, const std::vector<HeadFrame>& all) {
    label.check_members(
        {"track", "category", "time_s", "frame", "size", "position", "yaw_deg", "quaternion"});
    const auto size = label.at("size").numbers<3>();
    return {label.at("track").text(kLongestName),
            label.at("category").text(kLongestName),
            {size[0], size[1], size[2]},
            time_of(label, all),
            pose_of(label)};
}

}  // namespace

std::optional<std::vector<Pose>> read_poses(const fs::path& file, const std::vector<HeadFrame>& frames) {
    if (!path_exists(file)) return std::nullopt;
    const std::vector<std::string> lines = split_lines(read_text(file));
    const auto first = std::find_if(lines.begin(), lines.end(),
                                    [](const std::string& line) { return !content(line).empty(); });
    if (first == lines.end())
        throw DataError(fmt::format("{}: no pose, expected 12 or 8 numbers a line", file.string()));
    if (const auto numbers = parse_numbers(content(*first)); !numbers || numbers->size() != 12)
        return interpolated(read_track(lines, file.string()), frames, file.string());
    std::vector<int> numbers;
    for (const HeadFrame& frame : frames) numbers.push_back(frame.number);
    return kitti::read_pose_file(file, numbers);
}

std::vector<BoxTrack> read_boxes(const fs::path& path, const std::vector<HeadFrame>& frames,
                                 const std::vector<HeadFrame>& all) {
    if (!path_exists(path)) return {};
    const std::string file = path.string();
    const nlohmann::json json = parse_json(read_text(file), file);
    const JsonField root(json, file, "");
    root.check_members({"boxes"});
    const JsonField boxes = root.at("boxes");
    const double first_s = frames.front().time_s, last_s = frames.back().time_s;
    const bool from_start = first_s == all.front().time_s, to_end = last_s == all.back().time_s;
    std::vector<BoxLabel> labels;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const BoxLabel label = read_label(boxes.at(i), all);
        if ((from_start || label.time_s >= first_s) && (to_end || label.time_s <= last_s))
            labels.push_back(label);
    }
    return tracks_of(labels);
}

}  // namespace relidar::folder
