// SPDX-License-Identifier: Apache-2.0
#include "session.hpp"

#include <nlohmann/json.hpp>

#include "base/fail.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxWaiting = 4;
constexpr const char* kTooManyRequests =
    "cannot accept the request: too many requests are pending; wait for the answer before you send the next "
    "one";

const char* request_name(const BrowserRequest& request) {
    static constexpr const char* kRequestNames[] = {"scan", "sensor", "save", "ground"};
    return kRequestNames[request.index()];
}

std::string dump_utf8(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

const char* state_name(RecordedScans::State state) {
    if (state == RecordedScans::State::ready) return "ready";
    if (state == RecordedScans::State::missing) return "missing";
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
    if (is_closing_) return;
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
/// the newest view matters. All other requests are executed in order. If a request is not
/// accepted, take_job() sends the reason.
void ViewerSession::handle_message(TabId id, const std::string& message) {
    std::optional<BrowserRequest> request;
    std::string parse_error;
    try {
        request = parse_request(message);
    } catch (const UsageError& error) {
        parse_error = error.what();
    }
    const std::lock_guard lock(mutex_);
    const auto tab_entry = tabs_.find(id);
    if (tab_entry == tabs_.end() || is_closing_) return;
    BrowserTabState& tab = *tab_entry->second;
    if (!request) tab.rejection = parse_error;
    else if (auto* scan = std::get_if<LiveScanRequest>(&*request)) tab.newest_scan = std::move(*scan);
    else if (tab.other_requests.size() < kMaxWaiting) tab.other_requests.push_back(std::move(*request));
    else tab.rejection = kTooManyRequests;
    arrived_.notify_one();
}

/// Makes a job that sends a JSON text to a tab. `make_answer` runs on the render thread.
ViewerSession::ViewerJob ViewerSession::text_job(TabId tab_id, const char* name,
                                                 std::function<Json()> make_answer) const {
    return {tab_id, name, [this, tab_id, make_answer] { answers_.text(tab_id, dump_utf8(make_answer())); }};
}

/// Removes the most urgent job from the state of a tab and returns it, or no value if
/// there is none. The order is: first message, news of the log, reason of a rejection,
/// other requests, newest scan. Scans come last, so that a moving view does not delay
/// the others. The caller must hold the mutex. Jobs run later, without the mutex, and
/// share the state of the tab, because the tab may close before.
std::optional<ViewerSession::ViewerJob> ViewerSession::take_job(TabId tab_id,
                                                                const std::shared_ptr<BrowserTabState>& tab) {
    if (!tab->has_hello) {
        tab->has_hello = true;
        return text_job(tab_id, "hello", [this] {
            Json hello = scanner_.page_data();
            hello["save_folder"] = save_folder_.string();
            return hello;
        });
    }
    // Informs the page when the scans of the log are loaded, or cannot be loaded.
    const RecordedScans::State state = scanner_.measured_scans().state();
    if (tab->last_sent_state != state) {
        tab->last_sent_state = state;
        return text_job(tab_id, "log", [this, state] {
            return Json{
                {"kind", "log"}, {"state", state_name(state)}, {"why", scanner_.measured_scans().reason()}};
        });
    }
    if (tab->rejection) {
        const std::string reason = *std::exchange(tab->rejection, std::nullopt);
        return ViewerJob{tab_id, "message",
                         [this, tab_id, reason] { send_error(tab_id, "message", reason); }};
    }
    if (!tab->other_requests.empty()) {
        const BrowserRequest request = std::move(tab->other_requests.front());
        tab->other_requests.pop_front();
        return text_job(tab_id, request_name(request), [this, tab, request] {
            Json response = execute(tab->cache, request);
            response["kind"] = std::holds_alternative<SaveRequest>(request) ? "saved" : request_name(request);
            return response;
        });
    }
    if (tab->newest_scan) {
        const LiveScanRequest request = *std::exchange(tab->newest_scan, std::nullopt);
        return ViewerJob{tab_id, request_name(request), [this, tab_id, tab, request] {
                             answers_.frame(tab_id, scanner_.render_message(tab->cache, request));
                         }};
    }
    return {};
}

/// Returns the next job of any browser tab. Starts with the tab after the previous one,
/// so that all tabs are served in turn.
std::optional<ViewerSession::ViewerJob> ViewerSession::wait_for_job(std::chrono::milliseconds max_wait) {
    std::optional<ViewerJob> job;
    const auto find_job = [&] {
        auto tab = tabs_.upper_bound(last_served_);
        for (std::size_t i = 0; i < tabs_.size() && !job; ++i) {
            if (tab == tabs_.end()) tab = tabs_.begin();
            job = take_job(tab->first, tab->second);
            ++tab;
        }
        return job.has_value();
    };
    std::unique_lock lock(mutex_);
    arrived_.wait_for(lock, max_wait, find_job);  // Calls it again when a message has arrived.
    if (job) last_served_ = job->id;
    return job;
}

/// Rejects new requests and executes the pending requests.
void ViewerSession::finish_requests() {
    {
        const std::lock_guard lock(mutex_);
        is_closing_ = true;
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
        send_error(job->id, job->request_name, error.what());
    }
    return true;
}

/// Executes a request other than a scan, and returns the answer.
Json ViewerSession::execute(TabCache& cache, const BrowserRequest& request) const {
    if (const auto* save = std::get_if<SaveRequest>(&request)) return save_edited(*save);
    if (const auto* file = std::get_if<SensorFile>(&request)) return scanner_.store_sensor(cache, *file);
    const ActorEdits::ActorCopy copy =
        copy_on_ground(scanner_.trained_run(), scanner_.other_runs(), std::get<GroundPoseRequest>(request));
    return {{"of", copy.of}, {"from", copy.from}, {"at", copy.at}};
}

/// Saves the edited run under a new name. Never overwrites a folder.
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
