// SPDX-License-Identifier: Apache-2.0
// Converts scans to the vehicle poses, points and actor boxes that a recording stores.
#pragma once

#include <relidar/simulate/scan_files.hpp>
#include "recorded_moment.hpp"

namespace relidar::scan_files {

class SweepRecorder {
public:
    explicit SweepRecorder(std::vector<ScanOutputOptions> sensors)
        : sensors_(std::move(sensors)), earth_(recorded_rig().earth) {}
    RecordedRig recorded_rig() const;
    /// @param scans one scan per sensor, all with the same time
    /// @throws DataError if times decrease, or if the file format cannot represent them
    RecordedSweep record(std::span<const RenderedScan> scans);

private:
    std::vector<ScanOutputOptions> sensors_;
    std::optional<GeoConverter> earth_;  ///< RecordedRig::earth
    std::optional<double> last_scan_s_;  ///< time of the previous scan in the log
    std::optional<std::uint64_t> last_pose_ns_;

    std::uint64_t to_stamp_ns(double time_s) const;
    std::vector<RecordedPose> vehicle_poses(const RenderedScan& scan, std::vector<double> times_s);
    RecordedCloud make_cloud(const RenderedScan& scan, const ScanOutputOptions& format, double first_s) const;
    std::vector<RecordedActor> recorded_actors(const RenderedScan& scan, double cloud_time_s) const;
};

}  // namespace relidar::scan_files
