// SPDX-License-Identifier: Apache-2.0
#include "real_scans.hpp"

#include <numeric>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/evaluation.hpp>

namespace relidar::view {
namespace {

std::unique_ptr<TrainedRun> copy_run_without_surfel_scene(const TrainedRun& run) {
    auto result = std::make_unique<TrainedRun>();
    result->folder = run.folder;
    result->config = run.config;
    result->sequence = run.sequence;
    return result;
}

}  // namespace

RecordedScans::RecordedScans(const TrainedRun& run)
    : frames_(copy_run_without_surfel_scene(run)), reader_([this] { load_measured_scans(); }) {}

RecordedScans::~RecordedScans() {
    stop_ = true;
    reader_.join();
}

const LidarSequence* RecordedScans::get_log_with_scans_or_null() const {
    return state_ == RecordedScansState::ready ? &frames_->sequence : nullptr;
}

std::string RecordedScans::get_reason_for_missing_scans() const {
    return state_ == RecordedScansState::missing ? why_ : "";
}

void RecordedScans::load_measured_scans() {
    try {
        const ProgressReporter until_stopped = [this](std::string_view, double) {
            if (stop_) throw Error(ExitCode::interrupted, "interrupted while the log was being read");
        };
        store_scans_above_limit_in_file(std::uint64_t(frames_->config.dataset.memory_mib) << 20);
        const LidarSequence log = load_log(frames_->config, until_stopped);
        std::vector<int> all(frames_->sequence.frames.size());
        std::iota(all.begin(), all.end(), 0);
        copy_scans_into_run(*frames_, all, log);
        state_ = RecordedScansState::ready;
    } catch (const std::exception& error) {
        why_ = error.what();
        state_ = RecordedScansState::missing;
    }
}

}  // namespace relidar::view
