// SPDX-License-Identifier: Apache-2.0
// Creates the error message for an invalid command line. The parser stores each
// unexpected word in the command that read this word. The message names the first
// unexpected word, because it is the user's mistake.
#include "usage.hpp"

#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>

namespace relidar::cli {
namespace {

std::vector<std::string> list_command_names(const CLI::App& app) {
    std::vector<std::string> names;
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
        names.push_back(command->get_name());
    return names;
}

/// Replaces the parser message "Could not convert: --device = x" by a message that also
/// names the expected value. All other messages stay as they are.
std::string explain_conversion_error(const std::string& parser_message) {
    const std::string start = "Could not convert: ", middle = " = ";
    const std::size_t at = parser_message.find(middle);
    if (parser_message.rfind(start, 0) != 0 || at == std::string::npos) return parser_message;
    return fmt::format("{}: found \"{}\", expected an integer",
                       parser_message.substr(start.size(), at - start.size()),
                       parser_message.substr(at + middle.size()));
}

}  // namespace

std::string make_usage_error_message(const CLI::App& app, const std::string& parser_message) {
    const CLI::App* chosen = &app;
    std::string path = app.get_name();
    while (!chosen->get_subcommands().empty()) {
        chosen = chosen->get_subcommands().front();
        path += " " + chosen->get_name();
    }
    const CLI::App& command = *chosen;
    const std::string help = path + " --help";
    std::vector<std::string> unexpected = app.remaining(true);
    if (unexpected.empty() && parser_message.find("subcommand") != std::string::npos)
        return fmt::format("found no subcommand; expected one of {} (see `{}`)",
                           fmt::join(list_command_names(command), ", "), help);
    if (unexpected.empty())
        return fmt::format("{} (see `{}`)", explain_conversion_error(parser_message), help);
    // Leaves out the value of an option that was typed as --name=value.
    const std::string word = unexpected.front().substr(0, unexpected.front().find('='));
    if (word.size() > 1 && word.front() == '-') {
        std::vector<std::string> option_names;
        for (const CLI::Option* option : command.get_options())
            for (const std::string& name : option->get_lnames()) option_names.push_back("--" + name);
        return fmt::format("unknown option {}{} (see `{}`)", word, format_name_suggestion(word, option_names),
                           help);
    }
    if (const std::vector<std::string> names = list_command_names(command); !names.empty())
        return fmt::format("unknown command {}{} (see `{}`)", word, format_name_suggestion(word, names),
                           help);
    return fmt::format("unexpected argument {}; the command does not accept it (see `{}`)", word, help);
}

}  // namespace relidar::cli
