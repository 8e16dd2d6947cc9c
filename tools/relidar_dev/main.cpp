// SPDX-License-Identifier: Apache-2.0
// The program relidar-dev measures performance for developers of relidar. It is not
// installed.
#include "commands.hpp"
#include "program.hpp"

namespace {

void add_dev_commands(CLI::App& app, relidar::cli::Call& call) {
    relidar::cli::add_dev_bench(app, call);
    relidar::cli::add_pipelines(app, call);
}

}  // namespace

int main(int argc, char** argv) {
    return relidar::cli::run_program({"relidar-dev", "relidar-dev: measurements for developers of relidar",
                                      "Exit codes as of relidar.", add_dev_commands},
                                     argc, argv);
}
