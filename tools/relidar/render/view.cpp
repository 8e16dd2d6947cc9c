// SPDX-License-Identifier: Apache-2.0
// The command `relidar view` shows a run in the browser. The program renders new scans
// while the user changes the scene.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/run/stage_options.hpp>
#include "../../network/descriptors.hpp"
#include "../../network/host_port.hpp"
#include "../../network/loopback.hpp"
#include "../../view/foxglove.hpp"
#include "../../view/server.hpp"
#include "../../view/session.hpp"
#include "base/fail.hpp"
#include "browser.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "output_folder.hpp"

namespace relidar::cli {
namespace {

struct ViewOptions {
    std::string run;
    /// the user can insert their actors on the web page
    std::vector<std::string> inserts;
    std::string save_to;
    std::string address = "127.0.0.1";
    int port = 8080;
    std::vector<std::string> sets;
    std::optional<std::string> channels;
    DeviceCommandOptions device;
    bool no_refine = false;
    bool open = false;
    bool quiet = false;
};

// Until the loop notices Ctrl-C.
constexpr std::chrono::milliseconds kMaxWait{50};
// For slow browser tabs.
constexpr std::chrono::seconds kMaxShutdownTime{5};

/// The web page shows these runs under the folder names that the user typed.
view::OtherRunsByName load_other_runs(const std::vector<std::string>& folders) {
    view::OtherRunsByName runs;
    for (const std::string& folder : folders) runs.emplace(folder, load_run(folder));
    return runs;
}

/// Checks address and port, and returns the settings of the web server.
view::WebServerOptions server_options(const ViewOptions& options) {
    if (options.port < 0 || options.port > kLastPort)
        fail<UsageError>("--port: found {}; expected a number from 0 to {}, where 0 selects a free port",
                         options.port, kLastPort);
    view::WebServerOptions server;
    server.address = options.address;
    server.port = options.port;
    server.assets = view::web_page_files();
    view::check_address(options.address);
    // Other machines can connect, so clients must present a token.
    if (!is_loopback(options.address)) server.token = view::make_token();
    return server;
}

/// Serves the web page of a run until Ctrl-C, and renders what browser tabs and Foxglove
/// clients request. Only this thread uses the device.
void run_view(const ViewOptions& options) {
    raise_file_limit();
    // Checks the address before the run is loaded, because loading takes a long time.
    const view::WebServerOptions server_settings = server_options(options);
    check_settings_used(options.sets, render_settings(), "view");
    Run run = load_configured_run(options.run, options.sets, options.channels, options.no_refine);
    std::optional<OutputFolder> created;  // Removes the folder at exit if it is still empty.
    if (!options.save_to.empty()) created.emplace(options.save_to);
    const std::filesystem::path save_to =
        options.save_to.empty() ? run.folder / ".." : std::filesystem::path(options.save_to);
    const std::filesystem::path save_folder = std::filesystem::absolute(save_to).lexically_normal();
    Device device(to_device_options(options.device));
    // `session` and `foxglove` send results to the server, which calls them. The server
    // is created last and destroyed first, so they need this pointer to it.
    view::WebServer* out = nullptr;
    view::ViewerSession session(
        std::move(run), load_other_runs(options.inserts), device, save_folder,
        {[&](view::TabId tab, std::string text) { out->send_text(tab, std::move(text)); },
         [&](view::TabId tab, std::string frame) { out->send_newest(tab, std::move(frame)); }});
    view::FoxglovePlayer foxglove(
        session.trained_run(), device,
        {[&](view::ClientId client, std::string text) { out->send_text(client, std::move(text)); },
         [&](view::ClientId client, std::vector<std::string> scan) {
             out->send_batch(client, std::move(scan));
         }});
    view::WebSocketEvents events;
    events.opened = [&](view::ClientId tab) { session.open_tab(tab); };
    events.foxglove_opened = [&](view::ClientId client) { foxglove.add_client(client); };
    events.message = [&](view::ClientId client, std::string text) {
        if (!foxglove.handle_message(client, text)) session.handle_message(client, text);
    };
    events.closed = [&](view::ClientId client) {
        foxglove.remove_client(client);
        session.close_tab(client);
    };
    view::WebServer server(server_settings, std::move(events));
    out = &server;

    install_handlers();
    print(server.page_url() + "\n");
    std::fflush(stdout);
    const char* access = server_settings.token.empty() ? "open this address in a browser"
                                                       : "only clients that know this address have access";
    if (!options.quiet) print_note(fmt::format("{}; Ctrl-C ends the program", access));
    if (options.open) open_in_browser(server.page_url());

    // Waits for requests of the page until Foxglove needs its next scan.
    while (!is_interrupted()) session.run_next(foxglove.send_due(kMaxWait));
    session.finish_requests();
    server.drain(kMaxShutdownTime);
}

constexpr const char* kViewHelp =
    R"(The page moves the sensor with mouse and keys, plays the log, and changes sensor and traffic. The
key ? lists all keys. The page also shows the real scans if the log is still at its path. The URL
of the page contains its state, including edits, and works again after the program is restarted.
docs/viewer.md describes the page. Foxglove and Lichtblick connect to the same address with ws://
instead of http:// and show the log in a loop.
Examples:
  relidar view run
  relidar view run --port 0 --open
  relidar view run --insert other                      # actors of `other` can be inserted
  ssh -L 8080:127.0.0.1:8080 machine relidar view run  # then open http://127.0.0.1:8080/ here)";

}  // namespace

/// Adds the command `relidar view` and its options to the parser.
void add_view(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("view", "show a run in the browser and move the sensor");
    const auto options = std::make_shared<ViewOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train` or `relidar edit`")->required();
    add_option(*command, "--port N", options->port, "port to listen on (default: 8080; 0: a free port)");
    add_option(*command, "--bind ADDRESS", options->address,
               "address to listen on (default: 127.0.0.1, only this machine; for any other address, the "
               "printed URL contains an access token that every client must present)");
    add_option(
        *command, "--save-to DIR", options->save_to,
        "folder for edited runs that the page saves, created if missing (default: the parent folder of RUN)");
    add_list_option(*command, "--insert RUN", options->inserts,
                    "another run whose actors can be inserted from the page; repeatable");
    command->add_flag("--open", options->open, "open a browser");
    add_channels_option(*command, options->channels);
    add_set_option(*command, options->sets);
    add_device_options(*command, options->device);
    add_no_refine_option(*command, options->no_refine);
    add_quiet_option(*command, options->quiet);
    command->footer(kViewHelp);
    run_after_parsing(*command, call, options, run_view);
}

}  // namespace relidar::cli
