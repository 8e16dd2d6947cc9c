// SPDX-License-Identifier: Apache-2.0
#include "session.hpp"

#include <nlohmann/json.hpp>

#include "base/fail.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxWaiting = 4;

const char* request_name(const BrowserRequest& request) {
    static constexpr const char* kRequestNames[] = {"scan", "sensor", "save", "ground"};
    return kRequestNames[request.index()];
}

std::string dump_utf8(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

const char* state_name(RecordedScans::RecordedScansState state) {
    if (state == RecordedScans::RecordedScansState::ready) return "ready";
    if (state == RecordedScans::RecordedScansState::missing) return "missing";
    return "loading";
}

}  // namespace

ViewerSession::ViewerSession(Run run, OtherRunsByName others, Device& device,
                             std::filesystem::path save_folder, TabSendCallbacks answers)
    : scanner_(std::move(run), std::move(others), device),
      save_folder_(std::move(save_folder)),
      answers_(std::move(answers)) {}

void ViewerSession::open_tab(TabId tab_id) {
    const std::lock_guard lock(mutex_);
    if (deaf_) return;
    tabs_[tab_id] = std::make_shared<BrowserTabState>();
    arrived_.notify_one();
}

void ViewerSession::close_tab(TabId tab_id) {
    const std::lock_guard lock(mutex_);
    tabs_.erase(tab_id);
}

void ViewerSession::send_error(TabId tab_id, const char* request_name, const std::string& reason) const {
    answers_.text(tab_id, dump_utf8({{"kind", "error"}, {"about", request_name}, {"text", reason}}));
}

/// Adds a request to the tab's queue. A newer scan replaces a waiting one, because only
/// the newest view matters. All other requests are executed in order.
void ViewerSession::handle_message(TabId id, const std::string& message) {
    std::optional<BrowserRequest> request;
    std::string why =
        "cannot accept the request: too many requests are pending; wait for the answer before you send the "
        "next one";
    try {
        request = parse_request(message);
    } catch (const UsageError& error) {
        why = error.what();
    }
    const std::lock_guard lock(mutex_);
    const auto tab_entry = tabs_.find(id);
    if (tab_entry == tabs_.end() || deaf_) return;
    BrowserTabState& tab = *tab_entry->second;
    if (request && std::holds_alternative<LiveScanRequest>(*request))
        tab.scan = std::get<LiveScanRequest>(std::move(*request));
    else if (request && tab.others.size() < kMaxWaiting) tab.others.push_back(std::move(*request));
    else tab.refused = why;
    arrived_.notify_one();
}

/// Returns the most urgent job of a browser tab, or no value if the tab has none. Scans
/// come last, so that a moving view does not delay other requests. The caller must hold
/// the mutex.
std::optional<ViewerSession::ViewerJob> ViewerSession::take_job(TabId tab_id,
                                                                const std::shared_ptr<BrowserTabState>& tab) {
    const auto text_job = [&](const char* about, auto make_answer) {
        return ViewerJob{tab_id, about,
                         [this, tab_id, make_answer] { answers_.text(tab_id, dump_utf8(make_answer())); }};
    };
    if (!std::exchange(tab->greeted, true))
        return text_job("hello", [this] {
            Json hello = scanner_.page_data();
            hello["save_folder"] = save_folder_.string();
            return hello;
        });
    const RecordedScans::RecordedScansState state = scanner_.measured_scans().state();
    if (std::exchange(tab->last_sent_state, state) != state)
        return text_job("log", [this, state] {
            return Json{
                {"kind", "log"}, {"state", state_name(state)}, {"why", scanner_.measured_scans().reason()}};
        });
    if (tab->refused) {
        const std::string why = *std::exchange(tab->refused, std::nullopt);
        return ViewerJob{tab_id, "message", [this, tab_id, why] { send_error(tab_id, "message", why); }};
    }
    if (!tab->others.empty()) {
        const BrowserRequest request = std::move(tab->others.front());
        tab->others.pop_front();
        return text_job(request_name(request), [this, tab, request] {
            Json response = execute(tab->cache, request);
            response["kind"] = std::holds_alternative<SaveRequest>(request) ? "saved" : request_name(request);
            return response;
        });
    }
    if (tab->scan) {
        const LiveScanRequest wish = *std::exchange(tab->scan, std::nullopt);
        return ViewerJob{tab_id, request_name(wish), [this, tab_id, tab, wish] {
                             answers_.frame(tab_id, scanner_.render_message(tab->cache, wish));
                         }};
    }
    return {};
}

/// Returns the next job of any browser tab. Starts with the tab after the previous one,
/// so that all tabs are served in turn.
std::optional<ViewerSession::ViewerJob> ViewerSession::wait_for_job(std::chrono::milliseconds max_wait) {
    std::optional<ViewerJob> job;
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
    arrived_.wait_for(lock, max_wait, look);
    if (job) last_served_ = job->id;
    return job;
}

void ViewerSession::finish_requests() {
    {
        const std::lock_guard lock(mutex_);
        deaf_ = true;
    }
    while (run_next(std::chrono::milliseconds(0))) {}
}

/// Executes one request of a browser tab, and waits at most `max_wait` for it. Returns
/// false if no request has arrived.
bool ViewerSession::run_next(std::chrono::milliseconds max_wait) {
    const std::optional<ViewerJob> job = wait_for_job(max_wait);
    if (!job) return false;
    try {
        job->run();
    } catch (const DeviceError&) {
        // Ends the viewer, because no tab can receive a scan without a device.
        throw;
    } catch (const Error& error) {
        send_error(job->id, job->about, error.what());
    }
    return true;
}

Json ViewerSession::execute(TabCache& cache, const BrowserRequest& request) const {
    if (const auto* wish = std::get_if<SaveRequest>(&request)) return save_edited(*wish);
    if (const auto* file = std::get_if<SensorFile>(&request)) return scanner_.store_sensor(cache, *file);
    const ActorEdits::ActorCopy copy =
        copy_on_ground(scanner_.trained_run(), scanner_.other_runs(), std::get<GroundPoseRequest>(request));
    return {{"of", copy.of}, {"from", copy.from}, {"at", copy.at}};
}

Json ViewerSession::save_edited(const SaveRequest& request) const {
    // Applies the edits first, so that invalid edits leave no folder behind.
    Run run = apply_edits(scanner_.trained_run(), scanner_.other_runs(), request.edits);
    const std::filesystem::path folder = save_folder_ / request.name;
    std::error_code failed;
    if (std::filesystem::exists(std::filesystem::symlink_status(folder, failed)))
        fail<UsageError>("cannot save {}: this name already exists in {}; choose another name", request.name,
                         save_folder_.string());
    run.folder = folder;
    save_run(run);
    return {{"folder", folder.string()}};
}

}  // namespace relidar::view
