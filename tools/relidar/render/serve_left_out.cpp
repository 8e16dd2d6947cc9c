// SPDX-License-Identifier: Apache-2.0
// Replaces serve.cpp in a build without gRPC. The command `relidar serve` then fails with
// an error that names the missing package.
#include <CLI/CLI.hpp>

#include "command.hpp"

namespace relidar::cli {

void add_serve(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("serve", "render scans for simulators through gRPC (not in this build)");
    command->allow_extras();
    command->footer(
        "Example:\n  tools/dev/setup --serve && cmake --preset release && cmake --build --preset release");
    command->callback([&call] {
        call.run = [] {
            throw UsageError(
                "serve is not available, because relidar was built without gRPC; run `tools/dev/setup "
                "--serve` and build relidar again");
        };
    });
}

}  // namespace relidar::cli
