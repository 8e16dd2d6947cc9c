// SPDX-License-Identifier: Apache-2.0
// Loads the scans of the log in a background thread, so that the web page opens
// immediately. If the log is missing, the user can still view the run.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>

namespace relidar {
struct TrainedRun;
struct LidarSequence;
}  // namespace relidar

namespace relidar::view {

class RecordedScans {
public:
    enum class RecordedScansState { loading, ready, missing };

    /// Starts to load the log on which the run was trained.
    explicit RecordedScans(const TrainedRun& run);
    /// Stops the background thread and waits until it has ended.
    ~RecordedScans();
    RecordedScans(const RecordedScans&) = delete;
    RecordedScans& operator=(const RecordedScans&) = delete;

    RecordedScansState get_loading_state() const { return state_; }
    /// Returns a one-line text that says why the scans are missing.
    std::string get_reason_for_missing_scans() const;
    /// Returns the frames of the run with their measured scans. Returns null until all
    /// scans are loaded.
    const LidarSequence* get_log_with_scans_or_null() const;

private:
    void load_measured_scans();

    const std::unique_ptr<TrainedRun> frames_;  ///< Settings and frames of the run, without its surfels.
    std::string why_;
    std::atomic<RecordedScansState> state_ = RecordedScansState::loading;
    std::atomic<bool> stop_ = false;
    std::thread reader_;
};

}  // namespace relidar::view
