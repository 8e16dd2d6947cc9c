// SPDX-License-Identifier: Apache-2.0
// Reads the timestamp files of a KITTI raw drive. Line i contains the time of scan i. It
// is empty if the scan is missing.
#include "base/fail.hpp"
#include "read/datasets/kitti/log_files.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include <relidar/log/log_time.hpp>
#include "base/files.hpp"
#include "base/median.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

/// Parses "YYYY-MM-DD HH:MM:SS.nnnnnnnnn" to nanoseconds since 1970. 64 bits reach up to
/// the year 2261.
std::int64_t parse_time_ns(const std::string& line, const std::string& where) {
    int year = 0, month = 0, day = 0, hour = 0, minute = 0;
    int n_read = 0;  // characters before the seconds; sscanf() sets it if all five numbers match
    std::sscanf(line.c_str(), "%4d-%2d-%2d %2d:%2d:%n", &year, &month, &day, &hour, &minute, &n_read);
    std::optional<double> second;
    if (n_read > 0) second = parse_number(trim(line.substr(std::size_t(n_read))));
    const bool is_date = year >= 1970 && year < 2200 && month >= 1 && month <= 12 && day >= 1 && day <= 31;
    const bool is_time = hour >= 0 && hour < 24 && minute >= 0 && minute < 60 && second && *second >= 0.0 &&
                         *second < 61.0;  // 60: a leap second
    if (!is_date || !is_time)
        fail("{}: found '{}', expected YYYY-MM-DD HH:MM:SS.nnnnnnnnn between the years 1970 and 2199", where,
             quote(line));
    const std::chrono::sys_days date(std::chrono::year(year) / month / day);
    const std::int64_t minutes = (date.time_since_epoch().count() * 24ll + hour) * 60 + minute;
    return minutes * 60'000'000'000ll + std::llround(*second * 1e9);
}

/// [frames] times in nanoseconds since 1970; no value for a frame without a scan
using Stamps = std::vector<std::optional<std::int64_t>>;

/// Reads one time per line. The line of a frame without a scan is empty.
Stamps read_stamps_ns(const fs::path& file) {
    if (!does_path_exist(file))
        fail("{}: no such file, expected one time per frame; copy the file from the download of the dataset",
             file.string());
    const std::vector<std::string> lines = split_lines(read_text_file(file));
    Stamps time_ns(lines.size());
    for (std::size_t l = 0; l < lines.size(); ++l)
        if (!trim(lines[l]).empty())
            time_ns[l] = parse_time_ns(lines[l], fmt::format("{} line {}", file.string(), l + 1));
    if (std::ranges::none_of(time_ns, [](const auto& time) { return time.has_value(); }))
        fail("{}: the file is empty, expected one time per frame", file.string());
    return time_ns;
}

}  // namespace

std::vector<double> read_frame_times(const fs::path& time_file, const std::vector<int>& numbers, Log& log) {
    const Stamps time_ns = read_stamps_ns(time_file);
    // read_stamps_ns() returns at least one time.
    const auto first = std::ranges::find_if(time_ns, [](const auto& time) { return time.has_value(); });
    const std::int64_t first_ns = first->value();
    set_log_start(log, first_ns,
                  "after 1970; the files have no time zone, so their local times are read as UTC");
    std::vector<double> time_s;
    for (std::size_t i = 0; i < numbers.size(); ++i) {
        const std::size_t line = std::size_t(numbers[i]);
        if (line >= time_ns.size())
            fail("{}: found {} lines, but frame {} needs line {}", time_file.string(), time_ns.size(),
                 numbers[i], line + 1);
        if (!time_ns[line])
            fail("{} line {}: the line is empty, expected the time of frame {}, because its scan exists",
                 time_file.string(), line + 1, numbers[i]);
        time_s.push_back(double(*time_ns[line] - first_ns) * 1e-9);
        if (i > 0 && !(time_s[i] > time_s[i - 1]))
            fail("{} line {}: the time is not later than the time of frame {}, expected increasing times",
                 time_file.string(), line + 1, numbers[i - 1]);
    }
    return time_s;
}

namespace {

/// Returns the median duration of sweeps, whose starts and ends are known.
/// @param end_file  file with the ends
/// @param missing  what the file has not, if no sweep has both times
/// @throws DataError without a sweep, or if the duration is not plausible
double find_period_s(const Stamps& starts_ns, const Stamps& ends_ns, const fs::path& end_file,
                     const char* missing) {
    std::vector<double> durations_s;
    for (std::size_t i = 0; i < std::min(starts_ns.size(), ends_ns.size()); ++i)
        if (starts_ns[i] && ends_ns[i]) durations_s.push_back(double(*ends_ns[i] - *starts_ns[i]) * 1e-9);
    if (durations_s.empty())
        fail("{}: found no {}, expected one line with a time for each sweep", end_file.string(), missing);
    const double period_s = compute_median(std::move(durations_s));
    if (!(period_s > 0.01 && period_s < 1.0))
        fail("{}: a sweep lasts {:.6g} s from start to end, expected 0.01 to 1 s", end_file.string(),
             period_s);
    return period_s;
}

}  // namespace

std::vector<double> read_times_s(const fs::path& file, const std::vector<int>& numbers) {
    std::vector<double> time_s;
    for (const auto& [text, where] : read::read_frame_lines(file, numbers)) {
        const auto seconds = parse_number(trim(text));
        if (!seconds) fail("{}: found '{}', expected a time in seconds", where, quote(text));
        time_s.push_back(*seconds);
    }
    return time_s;
}

double read_sweep_s(const fs::path& drive) {
    const fs::path folder = drive / "velodyne_points", end_file = folder / "timestamps_end.txt";
    const Stamps starts_ns = read_stamps_ns(folder / "timestamps_start.txt");
    return find_period_s(starts_ns, read_stamps_ns(end_file), end_file,
                         "sweep with a time both in this file and in timestamps_start.txt");
}

double read_time_step_s(const fs::path& time_file) {
    const Stamps time_ns = read_stamps_ns(time_file);
    // A sweep ends when the next one starts.
    return find_period_s(time_ns, {time_ns.begin() + 1, time_ns.end()}, time_file,
                         "two consecutive lines with times");
}

}  // namespace relidar::kitti
