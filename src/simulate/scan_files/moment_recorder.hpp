// SPDX-License-Identifier: Apache-2.0
// From scans to what recordings hold of them.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include <relidar/simulate/scan_files.hpp>
#include "recorded_moment.hpp"

namespace relidar::scan_files {

/// Turns scans into moments, one after the other.
class MomentRecorder {
public:
    explicit MomentRecorder(std::vector<ScanFormat> sensors) : sensors_(std::move(sensors)) {}
    RecordedRig rig() const;
    /// @param scans  one of each sensor, taken together @throws DataError for times that
    /// fall or that a file cannot have
    RecordedMoment take(std::span<const RenderedScan> scans);
    /// Added to times of the log, whole seconds: times of files begin at 0. Known with
    /// the first moment.
    double shift_s() const { return shift_s_.value_or(0.0); }

private:
    struct Sweep {
        double first_s, last_s;  ///< times of its rays, the log's
    };
    std::vector<ScanFormat> sensors_;
    std::optional<double> shift_s_;
    double last_scan_s_ = 0.0;  ///< the log's
    std::optional<std::uint64_t> last_pose_ns_;

    std::uint64_t stamp(double time_s) const;
    void check_times(const RenderedScan& scan, const Sweep& all);
    std::vector<RecordedPose> poses(const RenderedScan& scan, std::vector<double> times_s);
    Points cloud(const RenderedScan& scan, const ScanFormat& format, const Sweep& sweep) const;
    std::vector<RecordedActor> actors(const RenderedScan& scan, double stamp_s) const;
};

}  // namespace relidar::scan_files
