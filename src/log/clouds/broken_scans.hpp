// SPDX-License-Identifier: Apache-2.0
// Handles scans that cannot be read. By default, the first such scan is an error. With
// dataset.skip_broken, such scans are skipped with a note. Scans that can be read but are
// incomplete are always skipped with a note.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <string>

#include <relidar/base/error.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// The numbers and errors of broken scans. A reader numbers either the frames of the
/// sequence or its files.
class BrokenScans {
public:
    explicit BrokenScans(bool skip) : skip_(skip) {}

    /// Runs a step of reading scan i. Any thread can call this function. Does nothing if
    /// an earlier step of the same scan has failed.
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
    /// Marks scan i as broken, even if broken scans are an error. Used for scans that can
    /// be read but are incomplete. Their missing points would become dropped rays.
    void add(std::size_t i, const std::string& reason);
    std::size_t size() const { return reasons_.size(); }

    /// Adds a note to the log for each broken scan.
    /// @param n  number of all scans
    /// @throws DataError if all scans are broken
    void tell(Sequence& sequence, std::size_t n) const;
    /// Adds a note for each broken scan and removes its frame from the log. Poses that no
    /// other frame uses are also removed. The scans must have been numbered as the frames
    /// of the sequence.
    /// @throws DataError if all scans are broken
    void leave_out(Sequence& sequence) const;

private:
    static constexpr const char* kWayOut = "; dataset.skip_broken=true leaves such scans out";

    const bool skip_;
    mutable std::mutex lock_;
    std::map<std::size_t, std::string> reasons_;
};

}  // namespace relidar
