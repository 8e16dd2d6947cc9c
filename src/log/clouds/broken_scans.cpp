// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/broken_scans.hpp"

#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace relidar {

bool BrokenScans::has(std::size_t index) const {
    const std::lock_guard guard(lock_);
    return reasons_.contains(index);
}

void BrokenScans::add(std::size_t index, const std::string& reason) {
    const std::lock_guard guard(lock_);
    reasons_.try_emplace(index, reason);
}

void BrokenScans::add_broken_scan_notes(Sequence& sequence, std::size_t count) const {
    if (!reasons_.empty() && reasons_.size() == count)
        throw DataError(fmt::format("{}: all {} scans are broken; the first error is: {}", sequence.source,
                                    count, reasons_.begin()->second));
    for (const auto& [i, reason] : reasons_)
        sequence.notes.push_back(fmt::format("a broken scan is skipped: {}", reason));
}

void BrokenScans::leave_out(Sequence& sequence) const {
    add_broken_scan_notes(sequence, sequence.frames.size());
    if (reasons_.empty()) return;
    std::vector<Frame> kept;
    std::set<double> times_s;
    for (std::size_t i = 0; i < sequence.frames.size(); ++i) {
        if (reasons_.contains(i)) continue;
        times_s.insert(sequence.frames[i].time_s);
        kept.push_back(std::move(sequence.frames[i]));
    }
    sequence.frames = std::move(kept);
    const PoseTrack all = std::exchange(sequence.world_from_vehicle, {});
    for (std::size_t i = 0; i < all.time_s.size(); ++i) {
        if (!times_s.contains(all.time_s[i])) continue;
        sequence.world_from_vehicle.time_s.push_back(all.time_s[i]);
        sequence.world_from_vehicle.pose.push_back(all.pose[i]);
    }
}

}  // namespace relidar
