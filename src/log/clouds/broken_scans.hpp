// SPDX-License-Identifier: Apache-2.0
// Handling of scans that cannot be read. The first broken scan ends the reading, or
// (dataset.skip_broken) broken scans are skipped with a note.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <string>

#include <relidar/base/error.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Broken scans by number. The reader counts either frames of the sequence or files.
class BrokenScans {
public:
    explicit BrokenScans(bool skip) : skip_(skip) {}

    /// Runs a reading step of scan i. Can be called from any thread. Does nothing if an
    /// earlier step of the scan failed.
    /// @throws DataError of the step, unless broken scans are skipped
    template <class Step>
    void attempt(std::size_t i, const Step& step) {
        if (has(i)) return;
        try {
            step();
        } catch (const DataError& error) {
            if (!skip_) throw DataError(std::string(error.what()) + kWayOut);
            add(i, error.what());
        }
    }

    bool has(std::size_t i) const;
    std::size_t size() const { return reasons_.size(); }

    /// Adds a note for each broken scan.
    /// @param n  number of scans
    /// @throws DataError if all scans are broken
    void tell(Sequence& sequence, std::size_t n) const;
    /// Adds the notes and removes the broken frames, with the poses that no other frame
    /// uses. Scans must be counted as the frames of the sequence.
    /// @throws DataError as tell()
    void leave_out(Sequence& sequence) const;

private:
    static constexpr const char* kWayOut = "; dataset.skip_broken=true leaves such scans out";

    const bool skip_;
    mutable std::mutex lock_;
    std::map<std::size_t, std::string> reasons_;

    void add(std::size_t i, const std::string& reason);
};

}  // namespace relidar
