// SPDX-License-Identifier: Apache-2.0
// Loads the scans of the log in a background thread, so that the web page opens
// immediately. If the log is missing, the user can still view the run.
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

    /// Starts to load the log on which the run was trained.
    explicit RealScans(const Run& run);
    /// Stops the background thread and waits until it has ended.
    ~RealScans();
    RealScans(const RealScans&) = delete;
    RealScans& operator=(const RealScans&) = delete;

    State state() const { return state_; }
    /// Returns a one-line text that says why the scans are missing.
    std::string why() const;
    /// Returns the frames of the run with their measured scans. Returns null until all
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
