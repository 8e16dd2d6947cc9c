// SPDX-License-Identifier: Apache-2.0
// Scans of a log that cannot be read: the first one ends the reading, or
// (dataset.skip_broken) each is left out with a note.
#pragma once

#include <cstddef>
#include <map>
#include <mutex>
#include <string>

#include <relidar/base/error.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// By number, as the reader counts them: frames of the sequence, or files.
class BrokenScans {
public:
    explicit BrokenScans(bool skip) : skip_(skip) {}

    /// Does a step of reading scan i, on any thread. A scan that an earlier step found
    /// broken is passed over.
    /// @throws DataError of the step, where broken scans are not left out
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

    /// A note for each. @param n  scans there are @throws DataError where all of them are
    /// broken
    void tell(Sequence& sequence, std::size_t n) const;
    /// Where scans are counted as the frames of the sequence: tells, and takes those
    /// frames out, with the poses of moments that no other frame has. @throws DataError
    /// as tell()
    void leave_out(Sequence& sequence) const;

private:
    static constexpr const char* kWayOut = "; dataset.skip_broken=true leaves such scans out";

    const bool skip_;
    mutable std::mutex lock_;
    std::map<std::size_t, std::string> reasons_;

    void add(std::size_t i, const std::string& reason);
};

}  // namespace relidar
