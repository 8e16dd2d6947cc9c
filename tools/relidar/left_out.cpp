// SPDX-License-Identifier: Apache-2.0
// Replaces the commands of libraries that this build lacks. They fail with an error that
// names the missing package.
#include <CLI/CLI.hpp>

#include "command.hpp"

namespace relidar::cli {

[[maybe_unused]] static void add_left_out(CLI::App& app, ParsedCommand& call, const char* name,
                                          const std::string& description, const char* error) {
    CLI::App* command = app.add_subcommand(name, description + " (not in this build)");
    command->allow_extras();
    command->footer(
        "Example:\n  tools/dev/setup --serve && cmake --preset release && cmake --build --preset release");
    command->callback([&call, error] { call.run = [error] { throw UsageError(error); }; });
}

#ifdef RELIDAR_WITHOUT_VIEW
void add_view(CLI::App& app, ParsedCommand& call) {
    add_left_out(app, call, "view", "show a run in the browser",
                 "view is not available, because relidar was built without Boost.Beast; install libboost-dev "
                 "(Debian) and run cmake with -DRELIDAR_VIEW=ON");
}
#endif

#ifdef RELIDAR_WITHOUT_SERVE
void add_serve(CLI::App& app, ParsedCommand& call) {
    add_left_out(app, call, "serve", "render scans for simulators through gRPC",
                 "serve is not available, because relidar was built without gRPC; run `tools/dev/setup "
                 "--serve` and build relidar again");
}
#endif

}  // namespace relidar::cli
