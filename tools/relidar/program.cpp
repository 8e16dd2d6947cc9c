// SPDX-License-Identifier: Apache-2.0
#include "program.hpp"
#include "base/fail.hpp"

#include <cstdio>
#include <exception>
#include <filesystem>
#include <new>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include "console.hpp"
#include "freed_memory.hpp"

namespace relidar::cli {
namespace {

std::vector<std::string> command_names(const CLI::App& app) {
    std::vector<std::string> names;
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
        names.push_back(command->get_name());
    return names;
}

/// Adds the expected value to the parser message "Could not convert: --device = x".
std::string explain_conversion(const std::string& parser_message) {
    const std::string start = "Could not convert: ", middle = " = ";
    const std::size_t at = parser_message.find(middle);
    if (parser_message.rfind(start, 0) != 0 || at == std::string::npos) return parser_message;
    return fmt::format("{}: found \"{}\", expected an integer",
                       parser_message.substr(start.size(), at - start.size()),
                       parser_message.substr(at + middle.size()));
}

/// Returns the long names of all options of a command.
std::vector<std::string> option_names(const CLI::App& command) {
    std::vector<std::string> names;
    for (const CLI::Option* option : command.get_options())
        for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
    return names;
}

/// Explains why a command line is wrong. Names the first unexpected word, because this is
/// the user's mistake, or returns the message of the parser if there is no such word.
/// @param app parser after it has failed; it stores the unexpected words
std::string usage_message(const CLI::App& app, const std::string& parser_message) {
    // Finds the command that the user has chosen, and its full name.
    const CLI::App* command = &app;
    std::string full_name = app.get_name();
    while (!command->get_subcommands().empty()) {
        command = command->get_subcommands().front();
        full_name += " " + command->get_name();
    }
    const std::string help = full_name + " --help";
    const std::vector<std::string> names = command_names(*command);
    const std::vector<std::string> unexpected = app.remaining(true);
    if (unexpected.empty() && parser_message.find("subcommand") != std::string::npos)
        return fmt::format("found no subcommand; expected one of {} (see `{}`)", fmt::join(names, ", "),
                           help);
    if (unexpected.empty()) return fmt::format("{} (see `{}`)", explain_conversion(parser_message), help);
    const std::string word = unexpected.front().substr(0, unexpected.front().find('='));
    const bool is_option = word.size() > 1 && word.front() == '-';
    if (is_option)
        return fmt::format("unknown option {}{} (see `{}`)", word, did_you_mean(word, option_names(*command)),
                           help);
    if (!names.empty())
        return fmt::format("unknown command {}{} (see `{}`)", word, did_you_mean(word, names), help);
    return fmt::format("unexpected argument {}; the command does not accept it (see `{}`)", word, help);
}

void flush_stdout() {
    if (std::fflush(stdout) != 0 || std::ferror(stdout))
        throw DataError(
            "cannot write all text to standard output: the disk is full or the reader has closed the pipe");
}

/// Returns the help text. Each command has only one line, so that it fits on one screen.
std::string format_help(const CLI::App& app) {
    std::string text = fmt::format("{}\nUsage: {} COMMAND [OPTIONS], COMMAND --help or --version\n\n",
                                   app.get_description(), app.get_name());
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
        text += fmt::format("  {:<9} {}\n", command->get_name(), command->get_description());
    return text + "\n" + app.get_footer() + "\n";
}

/// Parses the command line and runs the selected command. It runs after the parser has
/// ended, so that its errors are not handled as errors of the command line.
void parse_and_run(const ProgramDescription& program, int argc, char** argv) {
    CLI::App app(program.description, program.name);
    std::string args = program.name;
    for (int i = 1; i < argc; ++i) args += fmt::format(" {}", quote_for_shell(argv[i]));
    ParsedCommand call{args, {}};
    app.set_version_flag("--version", fmt::format("{} {}", program.name, RELIDAR_VERSION));
    app.require_subcommand(0, 1);  // At most one. A missing command is reported below.
    app.footer(program.footer);
    program.add_commands(app, call);  // Each command stores its function in `call` if it is chosen.
    app.formatter_fn(
        [](const CLI::App* shown, std::string, CLI::AppFormatMode) { return format_help(*shown); });
    try {
        app.parse(argc, argv);
    } catch (const CLI::Success& help) {
        app.exit(help);  // Prints the help text.
        return flush_stdout();
    } catch (const CLI::ParseError& error) {
        throw UsageError(usage_message(app, error.what()));
    }
    if (!call.run)
        fail<UsageError>("found no command; expected one; `{} --help` lists all commands", program.name);
    call.run();
    flush_stdout();
}

}  // namespace

/// Runs the command that the user typed. Converts exceptions to an exit code and a
/// one-line message.
int run_program(const ProgramDescription& program, int argc, char** argv) {
    const auto report = [&](ExitCode code, const std::string& message) {
        end_progress();
        std::fputs(fmt::format("{}: {}\n", program.name, make_one_line(message)).c_str(), stderr);
        return static_cast<int>(code);
    };
    keep_freed_memory();
    try {
        parse_and_run(program, argc, argv);
        return static_cast<int>(ExitCode::ok);
    } catch (const Error& error) {
        return report(error.code(), error.what());
    } catch (const std::bad_alloc&) {
        return report(ExitCode::data,
                      "out of memory: this machine has too little memory for this log or scene; use fewer "
                      "frames (--frames A:B) or larger voxels (--set init.voxel_m=METRES)");
    } catch (const std::filesystem::filesystem_error& error) {
        // Not the exit code for bugs, because a file system error is none.
        return report(ExitCode::data,
                      fmt::format("cannot access {}: {}", error.path1().string(), error.code().message()));
    } catch (const std::exception& error) {
        return report(ExitCode::bug,
                      std::string("internal error of relidar, please report it: ") + error.what());
    } catch (...) {
        return report(ExitCode::bug, "internal error of relidar, please report it: unknown exception");
    }
}

}  // namespace relidar::cli
