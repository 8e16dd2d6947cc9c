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
#include <relidar/log/log.hpp>

namespace relidar {

/// Errors of scans, which are identified by the index of their frame or file.
class ScanErrorCollector {
public:
    explicit ScanErrorCollector(bool skip) : skip_(skip) {}

    /// Calls `read_scan_part`, which reads a part of a scan. If it throws, stores the
    /// error and skips this scan in later calls. Several threads can call this function
    /// simultaneously.
    /// @throws DataError from `read_scan_part`, unless the user allows broken scans
    template <class Step>
    void guard(std::size_t scan_index, const Step& read_scan_part) {
        if (is_scan_broken(scan_index)) return;
        try {
            read_scan_part();
        } catch (const DataError& error) {
            const std::string text = error.what();
            // A scan with other columns is not broken: all scans of the log are alike.
            if (!skip_) throw DataError(text + (text.find(kOtherHint) == text.npos ? kSkipBrokenHint : ""));
            record_broken(scan_index, error.what());
        }
    }

    bool is_scan_broken(std::size_t scan_index) const;
    /// Marks a scan as broken, even without dataset.skip_broken. Used for truncated
    /// scans, because their missing points would look like rays without a return.
    void record_broken(std::size_t scan_index, const std::string& reason);
    std::size_t size() const { return reasons_.size(); }

    /// Adds a note about each broken scan.
    /// @throws DataError if all scans are broken
    void report_broken(Log& log, std::size_t n_scans) const;
    /// Removes the frames of broken scans, and the poses that only they use. Adds notes.
    /// The indices of scans must be indices in `log.frames`.
    /// @throws DataError if all scans are broken
    void remove_broken(Log& log) const;

private:
    static constexpr const char* kSkipBrokenHint =
        "; use dataset.skip_broken=true to skip scans that cannot be read";
    static constexpr const char* kOtherHint = "set \"columns\" in sequence.json";

    const bool skip_;
    mutable std::mutex lock_;
    std::map<std::size_t, std::string> reasons_;
};

}  // namespace relidar
