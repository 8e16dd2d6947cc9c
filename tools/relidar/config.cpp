// SPDX-License-Identifier: Apache-2.0
// relidar config: settings with their values and meanings, as the TOML that --config reads.
#include <memory>

#include <CLI/CLI.hpp>

#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {

void add_config(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("config", "print settings with their values and meanings, as TOML");
    const auto settings = std::make_shared<Settings>();
    const auto all = std::make_shared<bool>(false);
    add_settings_options(*command, *settings);
    command->add_flag("--all", *all, "expert settings too; without it those alone that differ from the preset");
    command->footer("Order: preset, then config file, then --set; the later one wins.\n"
                    "Examples:\n"
                    "  relidar config --preset quick\n"
                    "  relidar config --preset paper --set loss.depth=0.2 > mine.toml");
    command->callback([&call, settings, all] {
        call.run = [settings, all] { print(*all ? to_toml(resolve(*settings)) : to_short_toml(resolve(*settings))); };
    });
}

}  // namespace relidar::cli
