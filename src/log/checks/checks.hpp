// SPDX-License-Identifier: Apache-2.0
// Checks of a loaded log, whatever the dataset is. checks.cpp has the table.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>

#include "base/fail.hpp"

namespace relidar::checks {

/// Returns in one scan, or in several scans, and their intensities.
struct ReturnStatistics {
    std::size_t n_returns = 0, n_at_maximum = 0;
    float lowest = INFINITY, highest = -INFINITY;

    void add(const ReturnStatistics& other) {
        n_returns += other.n_returns;
        n_at_maximum += other.n_at_maximum;
        lowest = std::min(lowest, other.lowest);
        highest = std::max(highest, other.highest);
    }
};

/// A log, and the statistics of its scans, which all tests share.
struct CheckedLog {
    const Log& log;
    std::vector<ReturnStatistics> scans = {};  ///< [frames] empty for checks of errors
};

class FaultReport;
/// Reports each place where a log has a fault.
using Test = void(const CheckedLog& checked, const FaultReport& report);

/// A fault that a log can have.
struct Check {
    const char* id;
    Test& test;
    const char* text;       ///< {} are the values that the test reports
    bool is_error = false;  ///< true if the fault makes the log unusable; false for a note
};

/// Makes the message of a fault from the text of its check.
class FaultReport {
public:
    FaultReport(const Check& check, const Log& log, Notes& notes) : check_(check), log_(log), notes_(notes) {}

    /// Adds a note about the log, or throws DataError if the fault is an error.
    template <class... Values>
    void add(const Values&... values) const {
        add_for(-1, values...);
    }
    /// Adds a note about one LiDAR.
    template <class... Values>
    void add_for(int lidar, const Values&... values) const {
        std::string text = fmt::format(fmt::runtime(check_.text), values...);
        if (check_.is_error) fail("{}: {}", log_.name, text);
        const std::string name = lidar < 0 ? "" : log_.lidars[std::size_t(lidar)].name;
        notes_.push_back({check_.id, lidar, (name.empty() ? "" : "LiDAR '" + name + "': ") + text});
    }

private:
    const Check& check_;
    const Log& log_;
    Notes& notes_;
};

Test test_clock_jump, test_time_gaps, test_time_unit, test_speed, test_float_positions, test_few_returns,
    test_rotation, test_equal_intensities, test_dark, test_saturated, test_own_body, test_box_convention;

/// Corrects all boxes by the conventions that the user has set. Lists the conventions.
void correct_boxes(Log& log, const Conventions& set);

/// Removes boxes around a LiDAR or the vehicle's origin, with a note. Trackers and
/// simulators label the recording vehicle itself.
void remove_ego_boxes(Log& log);

/// Returns the probable fault of the boxes, or an empty text. Compares the points in the
/// boxes with the points in boxes of other conventions.
std::string describe_fault(const Log& log);

/// Adds a note for each fault that a log probably has, such as wrong units or incomplete
/// scans. check_log() throws if a fault makes the log unusable.
void note_faults(Log& log);

}  // namespace relidar::checks
