// SPDX-License-Identifier: Apache-2.0
// Handles Ctrl-C during long work. Finished files stay, and the work stops at the next
// safe point. A second Ctrl-C at least one second later ends the program immediately.
#pragma once

namespace relidar::cli {

/// Installs handlers for SIGINT and SIGTERM that record the signal instead of ending the
/// program.
void catch_interrupts();
bool interrupted();
/// Throws an error if the user has interrupted the program.
/// @throws Error with exit code 130
void stop_if_interrupted();

}  // namespace relidar::cli
