// SPDX-License-Identifier: Apache-2.0
// relidar config: every setting with its value and meaning, as the TOML that --config reads.
#include <memory>

#include <CLI/CLI.hpp>

#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {

void add_config(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("config", "print every setting with its value and meaning, as TOML");
    const auto settings = std::make_shared<Settings>();
    add_settings_options(*command, *settings);
    command->footer("Order: preset, then config file, then --set; the later one wins.\n"
                    "Examples:\n"
                    "  relidar config --preset quick\n"
                    "  relidar config --preset paper --set loss.depth=0.2 > mine.toml");
    command->callback([&call, settings] {
        call.run = [settings] { print(to_toml(resolve(*settings))); };
    });
}

}  // namespace relidar::cli
