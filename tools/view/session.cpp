// SPDX-License-Identifier: Apache-2.0
#include "session.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>

namespace relidar::view {
namespace {

using Json = nlohmann::json;

// Maximum number of queued requests of a browser tab, not counting scans. A user cannot
// click so fast that this limit is exceeded.
constexpr std::size_t kMaxWaiting = 4;

const char* get_request_name(const Request& request) {
    static constexpr const char* kNames[] = {"scan", "sensor", "save", "ground"};
    return kNames[request.index()];
}

std::string dump(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

const char* get_name(RealScans::State state) {
    return state == RealScans::State::ready     ? "ready"
           : state == RealScans::State::missing ? "missing"
                                                : "loading";
}

}  // namespace

Session::Session(Run run, OtherRuns other_runs, Device& device, std::filesystem::path save_folder,
                 Answers answers)
    : scanner_(std::move(run), std::move(other_runs), device),
      save_folder_(std::move(save_folder)),
      answers_(std::move(answers)) {}

void Session::open(TabId tab) {
    const std::lock_guard lock(mutex_);
    if (deaf_) return;
    tabs_[tab] = std::make_shared<Tab>();
    arrived_.notify_one();
}

void Session::close(TabId tab) {
    const std::lock_guard lock(mutex_);
    tabs_.erase(tab);
}

void Session::refuse(TabId id, const char* request_name, const std::string& why) const {
    answers_.text(id, dump({{"kind", "error"}, {"about", request_name}, {"text", why}}));
}

void Session::receive(TabId id, const std::string& message) {
    std::optional<Request> request;
    std::string why =
        "too many requests are pending; send the next request after the previous one is answered";
    try {
        request = parse_request(message);
    } catch (const UsageError& error) {
        why = error.what();
    }
    const std::lock_guard lock(mutex_);
    const auto tab_entry = tabs_.find(id);
    if (tab_entry == tabs_.end() || deaf_) return;
    Tab& tab = *tab_entry->second;
    if (request && std::holds_alternative<LiveScanRequest>(*request))
        tab.scan = std::get<LiveScanRequest>(std::move(*request));
    else if (request && tab.others.size() < kMaxWaiting) tab.others.push_back(std::move(*request));
    else tab.refused = why;
    arrived_.notify_one();
}

/// Returns the most urgent job of a browser tab, or no value if the tab has none. The
/// caller must hold the mutex.
std::optional<Session::Job> Session::take_job(TabId id, const std::shared_ptr<Tab>& tab) {
    if (!tab->greeted) {
        tab->greeted = true;
        return Job{id, "hello", [this, id] {
                       Json hello = scanner_.describe();
                       hello["save_folder"] = save_folder_.string();
                       answers_.text(id, dump(hello));
                   }};
    }
    if (const RealScans::State state = scanner_.real().state(); state != tab->told) {
        tab->told = state;
        return Job{
            id, "log", [this, id, state] {
                answers_.text(
                    id, dump({{"kind", "log"}, {"state", get_name(state)}, {"why", scanner_.real().why()}}));
            }};
    }
    if (tab->refused) {
        const std::string why = *std::exchange(tab->refused, std::nullopt);
        return Job{id, "message", [this, id, why] { refuse(id, "message", why); }};
    }
    if (!tab->others.empty()) {
        const Request request = std::move(tab->others.front());
        tab->others.pop_front();
        return Job{id, get_request_name(request), [this, id, tab, request] {
                       Json told = answer(tab->cache, request);
                       told["kind"] =
                           std::holds_alternative<SaveRequest>(request) ? "saved" : get_request_name(request);
                       answers_.text(id, dump(told));
                   }};
    }
    if (tab->scan) {
        const LiveScanRequest wish = *std::exchange(tab->scan, std::nullopt);
        return Job{id, get_request_name(wish),
                   [this, id, tab, wish] { answers_.frame(id, scanner_.scan(tab->cache, wish)); }};
    }
    return {};
}

/// Returns the next job of any browser tab. Starts with the tab after the previous one,
/// so that all tabs are served in turn.
std::optional<Session::Job> Session::wait_for_next_job(std::chrono::milliseconds patience) {
    std::optional<Job> job;
    const auto look = [&] {
        auto tab = tabs_.upper_bound(last_served_);
        for (std::size_t i = 0; i < tabs_.size() && !job; ++i) {
            if (tab == tabs_.end()) tab = tabs_.begin();
            job = take_job(tab->first, tab->second);
            ++tab;
        }
        return job.has_value();
    };
    std::unique_lock lock(mutex_);
    arrived_.wait_for(lock, patience, look);
    if (job) last_served_ = job->id;
    return job;
}

void Session::finish() {
    {
        const std::lock_guard lock(mutex_);
        deaf_ = true;
    }
    while (work(std::chrono::milliseconds(0))) {}
}

bool Session::work(std::chrono::milliseconds patience) {
    const std::optional<Job> job = wait_for_next_job(patience);
    if (!job) return false;
    try {
        job->run();
    } catch (const DeviceError&) {
        // A device error ends the viewer, because no browser tab can receive a scan
        // without a device.
        throw;
    } catch (const Error& error) {
        refuse(job->id, job->about, error.what());
    }
    return true;
}

Json Session::answer(TabCache& cache, const Request& request) const {
    if (const auto* wish = std::get_if<SaveRequest>(&request)) return save(*wish);
    if (const auto* file = std::get_if<SensorFile>(&request)) return scanner_.read_sensor(cache, *file);
    const ActorEdits::Copy copy =
        copy_on_ground(scanner_.run(), scanner_.others(), std::get<GroundRequest>(request));
    return {{"of", copy.of}, {"from", copy.from}, {"at", copy.at}};
}

Json Session::save(const SaveRequest& request) const {
    // Applies the edits before the folder is created, so that invalid edits leave no
    // folder behind.
    Run run = make_edited_run(scanner_.run(), scanner_.others(), request.edits);
    const std::filesystem::path folder = save_folder_ / request.name;
    std::error_code failed;
    if (std::filesystem::exists(std::filesystem::symlink_status(folder, failed)))
        throw UsageError(fmt::format("cannot save {}: this name already exists in {}; choose another name",
                                     request.name, save_folder_.string()));
    run.folder = folder;
    save_run(run);
    return {{"folder", folder.string()}};
}

}  // namespace relidar::view
