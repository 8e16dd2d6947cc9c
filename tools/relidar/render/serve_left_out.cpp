// SPDX-License-Identifier: Apache-2.0
// In the place of serve.cpp and bench_serve.cpp where gRPC was not there to build with: says how to get it.
#include <CLI/CLI.hpp>

#include "bench/serve.hpp"
#include "command.hpp"

namespace relidar::cli {
namespace {

[[noreturn]] void say_what_is_missing(const char* wanted) {
    throw UsageError(std::string(wanted) +
                     ": this program was built without gRPC, expected one with it: `tools/dev/setup --serve`, then build again");
}

}  // namespace

void add_serve(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("serve", "render scans of runs for simulators, by gRPC (not built in: needs libgrpc++-dev)");
    command->allow_extras();
    command->footer("Example:\n  tools/dev/setup --serve && cmake --preset release && cmake --build --preset release");
    command->callback([&call] { call.run = [] { say_what_is_missing("serve"); }; });
}

void bench_service(const ServeBench&) { say_what_is_missing("--serve"); }

}  // namespace relidar::cli
