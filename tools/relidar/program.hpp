// SPDX-License-Identifier: Apache-2.0
// Runs a program that consists of several commands. Parses the command line and prints
// the help. If a command fails, prints the error on stderr in one line and returns the
// exit code of the error (ExitCode in error.hpp).
#pragma once

#include <string>

#include "command.hpp"

namespace relidar::cli {

struct ProgramDescription {
    std::string name;         ///< Name of the program as the user types it.
    std::string description;  ///< One-line description.
    std::string footer;       ///< Text below the list of commands in the help of the program.
    void (*add_commands)(CLI::App& app, ParsedCommand& call);
};

int run_program(const ProgramDescription& program, int argc, char** argv);

}  // namespace relidar::cli
