// SPDX-License-Identifier: Apache-2.0
// Replaces view.cpp in a build without the viewer. The command `relidar view` then fails
// with an error that names the missing package.
#include <CLI/CLI.hpp>

#include "command.hpp"

namespace relidar::cli {

void add_view(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("view", "show a run in the browser (not in this build)");
    command->allow_extras();
    command->callback([&call] {
        call.run = [] {
            throw UsageError(
                "view is not available, because relidar was built without Boost.Beast; install libboost-dev "
                "(Debian) and run cmake with -DRELIDAR_VIEW=ON");
        };
    });
}

}  // namespace relidar::cli
