// SPDX-License-Identifier: Apache-2.0
#include "real_scans.hpp"

#include <numeric>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/evaluation.hpp>

namespace relidar::view {
namespace {

std::unique_ptr<Run> copy_run(const Run& run) {
    auto result = std::make_unique<Run>();
    result->folder = run.folder;
    result->config = run.config;
    result->log = run.log;
    return result;
}

}  // namespace

RecordedScans::RecordedScans(const Run& run) : frames_(copy_run(run)), reader_([this] { load_scans(); }) {}

RecordedScans::~RecordedScans() {
    stop_ = true;
    reader_.join();
}

const Log* RecordedScans::log() const { return state_ == State::ready ? &frames_->log : nullptr; }

std::string RecordedScans::reason() const { return state_ == State::missing ? why_ : ""; }

/// Loads the log on a background thread. If the log cannot be read, the viewer shows the
/// reason and works without measured scans.
void RecordedScans::load_scans() {
    try {
        // The exception ends load_log() if the viewer ends.
        const Progress check_stop = [this](std::string_view, double) {
            if (stop_) throw Error(ExitCode::interrupted, "interrupted while the log was being read");
        };
        limit_scan_memory(std::uint64_t(frames_->config.dataset.memory_mib) << 20);
        const Log log = load_log(frames_->config, check_stop);
        std::vector<int> all(frames_->log.frames.size());
        std::iota(all.begin(), all.end(), 0);
        copy_scans(*frames_, all, log);
        state_ = State::ready;  // From now on, other threads may read the scans.
    } catch (const std::exception& error) {
        // An exception that leaves the thread would end the program.
        why_ = error.what();
        state_ = State::missing;
    }
}

}  // namespace relidar::view
