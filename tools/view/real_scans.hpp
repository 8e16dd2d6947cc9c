// SPDX-License-Identifier: Apache-2.0
// Reads the scans of the log in a background thread, so that the page appears
// immediately. If the log is missing, the run can still be viewed.
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

    /// Starts to read the log on which the run was trained.
    explicit RealScans(const Run& run);
    /// Stops the reader thread and waits for it.
    ~RealScans();
    RealScans(const RealScans&) = delete;
    RealScans& operator=(const RealScans&) = delete;

    State state() const { return state_; }
    /// Returns the reason why the scans are missing, in one line.
    std::string why() const;
    /// Returns the frames of the run with their measured scans. Returns null until the
    /// scans are loaded.
    const Sequence* sequence() const;

private:
    void load();

    const std::unique_ptr<Run> frames_;  ///< Settings and frames of the run, without its surfels.
    std::string why_;
    std::atomic<State> state_ = State::loading;
    std::atomic<bool> stop_ = false;
    std::thread reader_;
};

}  // namespace relidar::view
