// SPDX-License-Identifier: Apache-2.0
#include "read/scans/broken_scans.hpp"

#include <set>
#include <utility>
#include <vector>

#include "base/fail.hpp"

namespace relidar {

bool ScanErrorCollector::is_scan_broken(std::size_t scan_index) const {
    const std::lock_guard guard(lock_);
    return reasons_.contains(scan_index);
}

void ScanErrorCollector::record_broken(std::size_t scan_index, const std::string& reason) {
    const std::lock_guard guard(lock_);
    reasons_.try_emplace(scan_index, reason);
}

void ScanErrorCollector::report_broken(Log& log, std::size_t n_scans) const {
    if (!reasons_.empty() && reasons_.size() == n_scans)
        fail("{}: none of the {} scans can be read; the first error is: {}", log.source, n_scans,
             reasons_.begin()->second);
    for (const auto& [i, reason] : reasons_)
        log.notes.push_back(fmt::format("a scan that cannot be read is skipped: {}", reason));
}

void ScanErrorCollector::remove_broken(Log& log) const {
    report_broken(log, log.frames.size());
    if (reasons_.empty()) return;
    std::vector<Frame> frames;
    for (std::size_t i = 0; i < log.frames.size(); ++i)
        if (!reasons_.contains(i)) frames.push_back(std::move(log.frames[i]));
    log.frames = std::move(frames);
    std::set<double> times_s;  // poses at other times are removed
    for (const Frame& frame : log.frames) times_s.insert(frame.time_s);
    const PoseTrack all = std::exchange(log.world_from_vehicle, {});
    for (std::size_t k = 0; k < all.time_s.size(); ++k)
        if (times_s.contains(all.time_s[k])) log.world_from_vehicle.append(all.time_s[k], all.pose[k]);
}

}  // namespace relidar
