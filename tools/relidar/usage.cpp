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

std::vector<std::string> command_names(const CLI::App& app) {
    std::vector<std::string> names;
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
        names.push_back(command->get_name());
    return names;
}

std::vector<std::string> option_names(const CLI::App& command) {
    std::vector<std::string> names;
    for (const CLI::Option* option : command.get_options()) {
        for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
    }
    return names;
}

/// Rewrites the parser message "Could not convert: --device = x", because it does not
/// name the expected value. All other messages stay as they are.
std::string in_our_words(const std::string& what) {
    const std::string start = "Could not convert: ", middle = " = ";
    const std::size_t at = what.find(middle);
    if (what.rfind(start, 0) != 0 || at == std::string::npos) return what;
    return fmt::format("{}: found \"{}\", expected an integer", what.substr(start.size(), at - start.size()),
                       what.substr(at + middle.size()));
}

std::string without_value(const std::string& option) { return option.substr(0, option.find('=')); }

}  // namespace

std::string usage_message(const CLI::App& app, const std::string& what) {
    const CLI::App* chosen = &app;
    std::string path = app.get_name();
    while (!chosen->get_subcommands().empty()) {
        chosen = chosen->get_subcommands().front();
        path += " " + chosen->get_name();
    }
    const CLI::App& command = *chosen;
    const std::string help = path + " --help";
    std::vector<std::string> unexpected = app.remaining(true);
    if (unexpected.empty() && what.find("subcommand") != std::string::npos)
        return fmt::format("no subcommand is given; expected one of {} (see `{}`)",
                           fmt::join(command_names(command), ", "), help);
    if (unexpected.empty()) return fmt::format("{} (see `{}`)", in_our_words(what), help);
    const std::string word = without_value(unexpected.front());
    if (word.size() > 1 && word.front() == '-') {
        return fmt::format("unknown option {}{} (see `{}`)", word, did_you_mean(word, option_names(command)),
                           help);
    }
    if (const std::vector<std::string> names = command_names(command); !names.empty())
        return fmt::format("unknown command {}{} (see `{}`)", word, did_you_mean(word, names), help);
    return fmt::format("unexpected argument {} (see `{}`)", word, help);
}

}  // namespace relidar::cli
