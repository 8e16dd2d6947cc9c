// SPDX-License-Identifier: Apache-2.0
// The command `relidar list settings` prints all settings with their values and
// descriptions. The output is a TOML file that the option --config can read.
#include <memory>

#include <CLI/CLI.hpp>

#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {

void add_list_settings(CLI::App& list_command, ParsedCommand& call) {
    CLI::App* command =
        list_command.add_subcommand("settings", "print settings with their values and descriptions, as TOML");
    const auto settings = std::make_shared<SettingsCommandOptions>();
    const auto all = std::make_shared<bool>(false);
    add_settings_options(*command, *settings);
    command->add_flag("--all", *all,
                      "also print all expert settings (default: only those that differ from the preset)");
    command->footer(
        "Later settings replace earlier ones in this order: preset, config file, --set.\nExamples:\n  "
        "relidar list settings --preset quick\n  relidar list settings --preset paper --set loss.depth=0.2 > "
        "mine.toml");
    command->callback([&call, settings, all] {
        call.run = [settings, all] {
            print(*all ? to_toml(make_config(*settings)) : to_short_toml(make_config(*settings)));
        };
    });
}

}  // namespace relidar::cli
