// SPDX-License-Identifier: Apache-2.0
// Reports the progress of slow work and measures the time of each stage of the work.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Callback that slow work calls from time to time, on the thread that started the work.
/// If the callback is empty, no progress is reported.
/// @param what short text of the current work
/// @param done completed fraction of the work, 0..1
using Progress = std::function<void(std::string_view what, double done)>;

/// Measures the time spent in each stage of slow work. Only one stage runs at a time.
/// Stages are listed in the order in which they were first started.
class StageTimes {
public:
    struct Stage {
        std::string name;
        double seconds = 0.0;
    };
    /// Ends the running stage and starts the named stage. If a stage runs several times,
    /// its times are added.
    void start_stage(std::string_view name) {
        end_stage();
        const auto existing_stage = std::ranges::find(stages_, name, &Stage::name);
        running_ = std::size_t(existing_stage - stages_.begin());
        if (existing_stage == stages_.end()) stages_.push_back({std::string(name)});
        since_ = std::chrono::steady_clock::now();
    }
    void end_stage() {
        if (running_ < stages_.size())
            stages_[running_].seconds +=
                std::chrono::duration<double>(std::chrono::steady_clock::now() - since_).count();
        running_ = kNoStage;
    }
    /// Returns all stages with their times. The time of a stage that is still running is
    /// not yet added.
    const std::vector<Stage>& stages() const { return stages_; }

private:
    static constexpr std::size_t kNoStage = std::size_t(-1);
    std::vector<Stage> stages_;
    std::size_t running_ = kNoStage;
    std::chrono::steady_clock::time_point since_{};
};

/// Starts the named stage if `times_or_null` is not null.
inline void begin_stage(StageTimes* times_or_null, std::string_view name) {
    if (times_or_null) times_or_null->start_stage(name);
}

}  // namespace relidar
