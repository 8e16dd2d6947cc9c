// SPDX-License-Identifier: Apache-2.0
// The command `relidar list` prints the devices, sensors and settings that other commands
// accept.
#include <memory>

#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

/// The output is a TOML file that the option --config can read.
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

}  // namespace

void add_list(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("list", "list devices, sensors or settings and their properties");
    command->require_subcommand(1);
    add_list_devices(*command, call);
    add_list_sensors(*command, call);
    add_list_settings(*command, call);
    command->footer(
        "Examples:\n"
        "  relidar list devices\n"
        "  relidar list sensors OS1-128\n"
        "  relidar list settings --preset quick");
}

}  // namespace relidar::cli
