// SPDX-License-Identifier: Apache-2.0
// A run that is looked at: one renderer, many tabs. Messages arrive on the server's
// thread; whoever calls work() renders, and is the only one that touches the device. Of
// the scans a tab asks for only the newest is rendered, and tabs take turns.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "request.hpp"
#include "scanner.hpp"

namespace relidar::view {

using TabId = std::uint64_t;

/// Where answers go; called by work() alone. Texts are JSON, each with its "kind":
///   hello (Scanner::describe), log {state, why}, sensor {name, rows, columns, rays}, ground {of, from, at}, saved {folder},
///   error {about, text}
struct Answers {
    std::function<void(TabId, std::string)> text;
    std::function<void(TabId, std::string)> frame;  ///< see frame.hpp
};

class Session {
public:
    /// @param others  runs whose actors can be inserted @param save_folder  in which
    /// edited runs are made
    Session(Run run, OtherRuns others, Device& device, std::filesystem::path save_folder, Answers answers);

    void open(TabId tab);
    void close(TabId tab);
    void receive(TabId tab, const std::string& message);

    /// Does one thing that a tab waits for, if one comes within `patience`. @return
    /// whether one came
    /// @throws DeviceError where the device has failed
    bool work(std::chrono::milliseconds patience);
    /// Hears nobody any more, and does all that tabs wait for now. @throws DeviceError
    void finish();

private:
    struct Tab {
        bool greeted = false;
        RealScans::State told = RealScans::State::loading;  ///< of the log
        std::optional<ScanWish> scan = {};                  ///< the newest that is not rendered
        std::deque<Request> others = {};          ///< sensor files, places on the ground and runs to save
        std::optional<std::string> refused = {};  ///< why the last message was none
        TabCache cache = {};                      ///< of the rendering thread alone
    };
    struct Job {
        TabId id;
        const char* about;  ///< what errors call it
        std::function<void()> run;
    };

    std::optional<Job> next_job(std::chrono::milliseconds patience);
    std::optional<Job> job_of(TabId id, const std::shared_ptr<Tab>& tab);
    nlohmann::json answer(TabCache& cache, const Request& request) const;
    void refuse(TabId id, const char* about, const std::string& why) const;
    nlohmann::json save(const SaveWish& wish) const;

    Scanner scanner_;
    const std::filesystem::path save_folder_;
    const Answers answers_;
    std::mutex mutex_;  ///< of what follows, but for caches
    std::condition_variable arrived_;
    std::map<TabId, std::shared_ptr<Tab>> tabs_;
    TabId last_served_ = 0;
    bool deaf_ = false;  ///< finish() was called
};

}  // namespace relidar::view
