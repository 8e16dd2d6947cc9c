// SPDX-License-Identifier: Apache-2.0
#include "real_scans.hpp"

#include <numeric>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/train/train.hpp>

namespace relidar::view {
namespace {

/// Returns a copy of a run without its surfels.
std::unique_ptr<Run> copy_without_scene(const Run& run) {
    auto result = std::make_unique<Run>();
    result->folder = run.folder;
    result->config = run.config;
    result->sequence = run.sequence;
    return result;
}

}  // namespace

RealScans::RealScans(const Run& run) : frames_(copy_without_scene(run)), reader_([this] { load(); }) {}

RealScans::~RealScans() {
    stop_ = true;
    reader_.join();
}

const Sequence* RealScans::sequence() const { return state_ == State::ready ? &frames_->sequence : nullptr; }

std::string RealScans::why() const { return state_ == State::missing ? why_ : ""; }

void RealScans::load() {
    try {
        const Progress until_stopped = [this](std::string_view, double) {
            if (stop_) throw Error(ExitCode::interrupted, "interrupted while the log was read");
        };
        const Sequence log = load_log(frames_->config, until_stopped);
        std::vector<int> all(frames_->sequence.frames.size());
        std::iota(all.begin(), all.end(), 0);
        attach_scans(*frames_, all, log);
        state_ = State::ready;
        // If the log cannot be read, the viewer shows the reason and works without
        // measured scans.
    } catch (const std::exception& error) {
        why_ = error.what();
        state_ = State::missing;
    }
}

}  // namespace relidar::view
