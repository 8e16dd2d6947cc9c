// SPDX-License-Identifier: Apache-2.0
// Loads the scans of the log in a background thread. The log may be missing.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>

namespace relidar {
struct Run;
struct Log;
}  // namespace relidar

namespace relidar::view {

class RecordedScans {
public:
    enum class State { loading, ready, missing };

    explicit RecordedScans(const Run& run);
    ~RecordedScans();

    State state() const { return state_; }
    std::string reason() const;
    const Log* log() const;

private:
    void load_scans();

    const std::unique_ptr<Run> frames_;  ///< Settings and frames of the run, without its surfels.
    std::string why_;
    std::atomic<State> state_ = State::loading;
    std::atomic<bool> stop_ = false;
    std::thread reader_;
};

}  // namespace relidar::view
