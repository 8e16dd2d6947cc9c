// SPDX-License-Identifier: Apache-2.0
// Connects many browser tabs to one renderer. Messages arrive on the server's thread.
// Only the thread that calls run_next() uses the device. Each tab
// receives only the newest scan that it has requested. Tabs are served in turn.
#pragma once

#include <condition_variable>
#include <deque>
#include <mutex>

#include "request.hpp"
#include "scanner.hpp"

namespace relidar::view {

using TabId = std::uint64_t;

/// Called only by the thread of run_next(). A text is a JSON object
/// whose member "kind" is hello, log, sensor, ground, saved or error.
struct TabSendCallbacks {
    std::function<void(TabId, std::string)> text;
    std::function<void(TabId, std::string)> frame;
};

class ViewerSession {
public:
    /// @param others other runs, whose actors the user can insert
    /// @param save_folder for edited runs
    ViewerSession(Run run, OtherRunsByName others, Device& device, std::filesystem::path save_folder,
                  TabSendCallbacks answers);

    const Run& trained_run() const { return scanner_.trained_run(); }

    void open_tab(TabId tab_id);
    void close_tab(TabId tab_id);
    void handle_message(TabId tab_id, const std::string& message);

    bool run_next(std::chrono::milliseconds max_wait);
    void finish_requests();

private:
    struct BrowserTabState {
        bool has_hello = false;  ///< The tab has received the description of the run.
        RecordedScans::State last_sent_state = RecordedScans::State::loading;
        std::optional<LiveScanRequest> newest_scan = {};
        std::deque<BrowserRequest> other_requests = {};  ///< Waiting requests that are not scans.
        std::optional<std::string> rejection = {};       ///< Reason why the last message was not accepted.
        TabCache cache = {};  ///< State of the tab that only the render thread uses, without the mutex.
    };
    struct ViewerJob {
        TabId id;
        const char* request_name;  ///< For error messages.
        std::function<void()> run;
    };

    std::optional<ViewerJob> wait_for_job(std::chrono::milliseconds max_wait);
    std::optional<ViewerJob> take_job(TabId tab_id, const std::shared_ptr<BrowserTabState>& tab);
    ViewerJob text_job(TabId tab_id, const char* name, std::function<nlohmann::json()> make_answer) const;
    nlohmann::json execute(TabCache& cache, const BrowserRequest& request) const;
    void send_error(TabId tab_id, const char* request_name, const std::string& reason) const;
    nlohmann::json save_edited(const SaveRequest& request) const;

    BrowserScanRenderer scanner_;
    const std::filesystem::path save_folder_;
    const TabSendCallbacks answers_;
    std::mutex mutex_;  ///< Protects the members below. The caches of the tabs need no protection.
    std::condition_variable arrived_;
    std::map<TabId, std::shared_ptr<BrowserTabState>> tabs_;
    TabId last_served_ = 0;
    bool is_closing_ = false;  ///< True after finish_requests(), so that new messages are ignored.
};

}  // namespace relidar::view
