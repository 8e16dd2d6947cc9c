// SPDX-License-Identifier: Apache-2.0
// Runs a program that consists of commands: parses the command line, prints help, and
// turns each failure into one line on stderr and an exit code (error.hpp).
#pragma once

#include <string>

#include "command.hpp"

namespace relidar::cli {

/// A program of several commands: relidar or relidar-dev.
struct Program {
    std::string name;         ///< as typed
    std::string description;  ///< one line
    std::string footer;       ///< what its help prints after the list of commands
    void (*add_commands)(CLI::App& app, Call& call);
};

/// Runs the command that the user typed. @return the exit code of the process
int run_program(const Program& program, int argc, char** argv);

}  // namespace relidar::cli
