// SPDX-License-Identifier: Apache-2.0
// Handles scans that cannot be read. By default, the first such scan causes an error.
// With dataset.skip_broken, such scans are skipped with a note. Scans that can be read
// but are incomplete are always skipped with a note.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <string>

#include <relidar/base/error.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Collects the errors of scans that cannot be read. The number of a scan is the index of
/// its frame or of its file.
class BrokenScans {
public:
    explicit BrokenScans(bool skip) : skip_(skip) {}

    /// Calls `step`, which reads a part of scan `index`. If `step` throws, stores the
    /// error and skips this scan in later calls. Several threads can call this function
    /// at the same time.
    /// @throws DataError of the step, unless the user allows broken scans
    template <class Step>
    void attempt(std::size_t index, const Step& step) {
        if (has(index)) return;
        try {
            step();
        } catch (const DataError& error) {
            if (!skip_) throw DataError(std::string(error.what()) + kWayOut);
            add(index, error.what());
        }
    }

    bool has(std::size_t index) const;
    /// Marks scan `index` as broken, even if the user does not allow broken scans. Used
    /// for readable scans with missing points, because missing points would count as
    /// dropped rays.
    void add(std::size_t index, const std::string& reason);
    std::size_t size() const { return reasons_.size(); }

    /// Adds a note for the user about each broken scan.
    /// @param count  total number of scans
    /// @throws DataError if all scans are broken
    void add_broken_scan_notes(Sequence& sequence, std::size_t count) const;
    /// Removes the frames of broken scans, and poses that no other frame uses. Adds a
    /// note for the user about each broken scan. Scan numbers must be indices of frames.
    /// @throws DataError if all scans are broken
    void leave_out(Sequence& sequence) const;

private:
    static constexpr const char* kWayOut = "; use dataset.skip_broken=true to skip broken scans";

    const bool skip_;
    mutable std::mutex lock_;
    std::map<std::size_t, std::string> reasons_;
};

}  // namespace relidar
