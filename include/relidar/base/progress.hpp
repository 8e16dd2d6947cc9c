// SPDX-License-Identifier: Apache-2.0
// How what takes longer than a moment says how far it is, and what it has spent its time
// on.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Called now and then by work that may take seconds, from the thread that started it.
/// May be empty: nothing is told.
/// @param what  is being done, in a few words @param done  share of it, 0..1
using Progress = std::function<void(std::string_view what, double done)>;

/// What long work spends its time on: stages, one after the other, in the order in which
/// they first began.
class StageTimes {
public:
    struct Stage {
        std::string name;
        double seconds = 0.0;
    };
    /// Ends the stage before and begins this one. One that was there before goes on
    /// counting.
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
    /// The one that runs has the seconds of its earlier turns alone.
    const std::vector<Stage>& stages() const { return stages_; }

private:
    static constexpr std::size_t kNone = std::size_t(-1);
    std::vector<Stage> stages_;
    std::size_t running_ = kNone;
    std::chrono::steady_clock::time_point since_{};
};

/// For work that is timed where somebody wants to know.
inline void begin_stage(StageTimes* times, std::string_view name) {
    if (times) times->begin(name);
}

}  // namespace relidar
