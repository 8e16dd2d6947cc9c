// SPDX-License-Identifier: Apache-2.0
#include "program.hpp"
#include "base/fail.hpp"

#include <cstdio>
#include <exception>
#include <filesystem>
#include <new>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include "console.hpp"
#include "freed_memory.hpp"
#include "usage.hpp"

namespace relidar::cli {
namespace {

void flush_stdout_or_throw() {
    if (std::fflush(stdout) != 0 || std::ferror(stdout))
        throw DataError(
            "cannot write all text to standard output: the disk is full or the reader has closed the pipe");
}

/// Returns the help text of the program. Each command has only one line, so that the text
/// fits on one screen.
std::string format_help_with_command_list(const CLI::App& app) {
    std::string text = fmt::format("{}\nUsage: {} COMMAND [OPTIONS], COMMAND --help or --version\n\n",
                                   app.get_description(), app.get_name());
    for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
        text += fmt::format("  {:<9} {}\n", command->get_name(), command->get_description());
    return text + "\n" + app.get_footer() + "\n";
}

void parse_and_run_command(const ProgramDescription& program, int argc, char** argv) {
    CLI::App app(program.description, program.name);
    std::string command_line = program.name;
    for (int i = 1; i < argc; ++i) command_line += fmt::format(" {}", quote_word_for_shell(argv[i]));
    ParsedCommand call{command_line, {}};
    app.set_version_flag("--version", fmt::format("{} {}", program.name, RELIDAR_VERSION));
    app.require_subcommand(0, 1);
    app.footer(program.footer);
    program.add_commands(app, call);
    app.formatter_fn([](const CLI::App* shown, std::string, CLI::AppFormatMode) {
        return format_help_with_command_list(*shown);
    });
    try {
        app.parse(argc, argv);
    } catch (const CLI::Success& help) {
        app.exit(help);  // Prints the help text.
        return flush_stdout_or_throw();
    } catch (const CLI::ParseError& error) {
        throw UsageError(make_usage_error_message(app, error.what()));
    }
    if (!call.run)
        fail<UsageError>("found no command; expected one; `{} --help` lists all commands", program.name);
    call.run();
    flush_stdout_or_throw();
}

}  // namespace

int run_program(const ProgramDescription& program, int argc, char** argv) {
    const auto report = [&](ExitCode code, const std::string& message) {
        end_progress_line();
        std::fputs(fmt::format("{}: {}\n", program.name, replace_control_characters(message)).c_str(),
                   stderr);
        return static_cast<int>(code);
    };
    make_malloc_keep_freed_memory();
    try {
        parse_and_run_command(program, argc, argv);
        return static_cast<int>(ExitCode::ok);
    } catch (const Error& error) {
        return report(error.code(), error.what());
    } catch (const std::bad_alloc&) {
        return report(ExitCode::data,
                      "out of memory: this machine has too little memory for this log or scene; use fewer "
                      "frames (--frames A:B) or larger voxels (--set init.voxel_m=METRES)");
    } catch (const std::filesystem::filesystem_error& error) {
        // Uses the exit code for invalid data, because a file system error is not a bug
        // of relidar.
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
