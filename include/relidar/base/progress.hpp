// SPDX-License-Identifier: Apache-2.0
// Progress reports and stage times of long-running work.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Callback that long-running work calls from time to time, on the thread that started
/// the work. If it is empty, no progress is reported.
/// @param what short description of the current work
/// @param done completed share of the work, 0..1
using Progress = std::function<void(std::string_view what, double done)>;

/// Time spent in each stage of long-running work. Stages run one after the other and are
/// listed in the order of their first start.
class StageTimes {
public:
    struct Stage {
        std::string name;
        double seconds = 0.0;
    };
    /// Ends the running stage and starts this one. If the stage has run before, its time
    /// accumulates.
    void begin(std::string_view name) {
        end();
        const auto known = std::ranges::find(stages_, name, &Stage::name);
        running_ = std::size_t(known - stages_.begin());
        if (known == stages_.end()) stages_.push_back({std::string(name)});
        since_ = std::chrono::steady_clock::now();
    }
    void end() {
        if (running_ < stages_.size())
            stages_[running_].seconds +=
                std::chrono::duration<double>(std::chrono::steady_clock::now() - since_).count();
        running_ = kNone;
    }
    /// Returns all stages. The time of the running stage excludes its current run.
    const std::vector<Stage>& stages() const { return stages_; }

private:
    static constexpr std::size_t kNone = std::size_t(-1);
    std::vector<Stage> stages_;
    std::size_t running_ = kNone;
    std::chrono::steady_clock::time_point since_{};
};

/// Starts a stage if `times` is not null.
inline void begin_stage(StageTimes* times, std::string_view name) {
    if (times) times->begin(name);
}

}  // namespace relidar
