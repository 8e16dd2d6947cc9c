// SPDX-License-Identifier: Apache-2.0
// Handles Ctrl-C during long work. The work stops at the next safe point, and finished
// files are kept. A second Ctrl-C at least one second later ends the program immediately.
#pragma once

namespace relidar::cli {

/// Installs handlers for SIGINT and SIGTERM. The handlers only store the time of the
/// signal, so that the program can stop at a safe point.
void catch_interrupts();
bool interrupted();
/// Throws an error if the user has pressed Ctrl-C.
/// @throws Error with exit code 130
void stop_if_interrupted();

}  // namespace relidar::cli
