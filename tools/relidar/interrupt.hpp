// SPDX-License-Identifier: Apache-2.0
// Handles Ctrl-C during long work. The work stops at the next safe point, and finished
// files are kept. If the user presses Ctrl-C again after more than one second, the
// program ends immediately.
#pragma once

namespace relidar::cli {

/// Installs handlers for SIGINT and SIGTERM. The handlers only store the time of the
/// signal, so that the program can stop at the next safe point.
void install_interrupt_handlers();
bool is_interrupted();
/// Throws an error if the user has pressed Ctrl-C, so that the program stops here.
/// @throws Error with exit code 130
void throw_if_interrupted();

}  // namespace relidar::cli
