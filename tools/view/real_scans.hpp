// SPDX-License-Identifier: Apache-2.0
// Reads the log's scans in the background, so that the page appears immediately. A run
// whose log is missing can still be viewed.
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

    /// Starts to read the log that the run was trained on.
    explicit RealScans(const Run& run);
    /// Waits for the reader thread, which stops at its next step.
    ~RealScans();
    RealScans(const RealScans&) = delete;
    RealScans& operator=(const RealScans&) = delete;

    State state() const { return state_; }
    /// Returns a one-line reason why the scans are missing.
    std::string why() const;
    /// Returns the frames of the run with their scans, or null until they are loaded.
    const Sequence* sequence() const;

private:
    void load();

    const std::unique_ptr<Run> frames_;  ///< Settings and sequence of the run, without its scene.
    std::string why_;
    std::atomic<State> state_ = State::loading;
    std::atomic<bool> stop_ = false;
    std::thread reader_;
};

}  // namespace relidar::view
