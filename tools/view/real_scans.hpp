// SPDX-License-Identifier: Apache-2.0
// The log's own scans, read in the background: the page is there at once, and a run whose
// log is gone can be viewed all the same.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>

namespace relidar {
struct Run;
struct Sequence;
}  // namespace relidar

namespace relidar::view {

class RealScans {
public:
    enum class State { loading, ready, missing };

    /// Begins to read the log that the run was trained on.
    explicit RealScans(const Run& run);
    /// Waits for the reader, which stops at its next step.
    ~RealScans();
    RealScans(const RealScans&) = delete;
    RealScans& operator=(const RealScans&) = delete;

    State state() const { return state_; }
    /// Why they are missing, one line.
    std::string why() const;
    /// The frames of the run with their scans; nothing while they are not ready.
    const Sequence* sequence() const;

private:
    void load();

    const std::unique_ptr<Run> frames_;  ///< settings and sequence, no scene
    std::string why_;
    std::atomic<State> state_ = State::loading;
    std::atomic<bool> stop_ = false;
    std::thread reader_;
};

}  // namespace relidar::view
