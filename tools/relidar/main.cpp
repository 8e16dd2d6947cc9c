// SPDX-License-Identifier: Apache-2.0
// relidar on the command line. Every failure ends here as one line on stderr and an exit code: 1 our own fault, 2 usage,
// 3 data, 4 device, 130 interrupted (error.hpp).
#include <cstdio>
#include <exception>
#include <filesystem>
#include <new>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "command.hpp"
#include "console.hpp"
#include "freed_memory.hpp"
#include "usage.hpp"

namespace {

using namespace relidar;

constexpr const char* kFooter =
    "First run:\n"
    "  relidar demo                                  a synthetic street: train, render, evaluate, report\n"
    "A log of your own:\n"
    "  relidar train LOG --out run                   LOG: a ROS bag, KITTI, Waymo, nuScenes ..., a folder of scans\n"
    "  relidar render run --out scans --frames all\n"
    "  relidar eval run\n"
    "  relidar view run                              look at it in the browser, and drive the sensor\n"
    "  relidar eval runs/*/ --table scores.md        the scores of several runs as a table\n"
    "  relidar edit run --out empty --remove 0       remove, move, copy, insert actors; render the result\n"
    "  relidar serve run                             scans for simulators, by gRPC\n"
    "`relidar COMMAND --help` says more. Exit codes: 0 done, 1 fault of relidar, 2 usage, 3 data, 4 device, 130 interrupted.";

std::string typed(int argc, char** argv) {
    std::string text = "relidar";
    for (int i = 1; i < argc; ++i) text += fmt::format(" {}", cli::shell_word(argv[i]));
    return text;
}

void flush_output() {
    if (std::fflush(stdout) != 0 || std::ferror(stdout)) throw DataError("writing to standard output: it cannot take all of the text");
}

void run(int argc, char** argv) {
    CLI::App app("relidar: turn a LiDAR log into a scene of surfels, and the scene into new LiDAR scans", "relidar");
    cli::Call call{typed(argc, argv), {}};
    app.set_version_flag("--version", std::string("relidar ") + RELIDAR_VERSION);
    app.require_subcommand(0, 1);
    app.footer(kFooter);
    cli::add_commands(app, call);
    try {
        app.parse(argc, argv);
    } catch (const CLI::Success& help) {
        app.exit(help);   // prints it
        return flush_output();
    } catch (const CLI::ParseError& error) {
        throw UsageError(cli::usage_message(app, error.what()));
    }
    if (!call.run) throw UsageError("found no command, expected one; `relidar --help` lists them");
    call.run();
    flush_output();
}

int report(ExitCode code, const std::string& message) {
    cli::end_progress_line();
    std::fputs(("relidar: " + cli::one_line(message) + "\n").c_str(), stderr);
    return static_cast<int>(code);
}

}  // namespace

int main(int argc, char** argv) {
    cli::keep_freed_memory();
    try {
        run(argc, argv);
        return static_cast<int>(ExitCode::ok);
    } catch (const Error& error) {
        return report(error.code(), error.what());
    } catch (const std::bad_alloc&) {
        return report(ExitCode::data,
                      "out of memory: the machine cannot hold this log or scene; take fewer frames (--frames a:b) or larger voxels (--set "
                      "init.voxel_m=...)");
    } catch (const std::filesystem::filesystem_error& error) {   // what the system refuses is no fault of ours
        return report(ExitCode::data, fmt::format("{}: {}", error.path1().string(), error.code().message()));
    } catch (const std::exception& error) {
        return report(ExitCode::bug, std::string("a fault of relidar itself: ") + error.what());
    } catch (...) {
        return report(ExitCode::bug, "a fault of relidar itself: an unknown exception");
    }
}
