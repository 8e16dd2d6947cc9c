// SPDX-License-Identifier: Apache-2.0
// The command `relidar list` prints the devices, sensors and settings that other commands
// accept.
#include <memory>

#include "command.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

struct ListSettingsOptions {
    SettingsCommandOptions settings;
    bool all = false;
};

/// Prints settings as a TOML file that the option --config can read.
void print_settings(const ListSettingsOptions& options) {
    const Config config = make_config(options.settings);
    print(options.all ? to_toml(config) : to_short_toml(config));
}

/// Adds the command `relidar list settings` and its options to the parser.
void add_list_settings(CLI::App& list_command, ParsedCommand& call) {
    CLI::App* command =
        list_command.add_subcommand("settings", "print settings with their values and descriptions, as TOML");
    const auto options = std::make_shared<ListSettingsOptions>();
    add_settings_options(*command, options->settings);
    command->add_flag("--all", options->all,
                      "also print all expert settings (default: only those that differ from the preset)");
    command->footer(
        "Later settings replace earlier ones in this order: preset, config file, --set.\nExamples:\n  "
        "relidar list settings --preset quick\n  relidar list settings --preset paper --set loss.depth=0.2 > "
        "mine.toml");
    run_after_parsing(*command, call, options, print_settings);
}

}  // namespace

/// Adds the command `relidar list`, which consists of three subcommands, to the parser.
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
