// SPDX-License-Identifier: Apache-2.0
// Handles Ctrl-C during long work. The work stops at the next safe point, and finished
// files are kept. If the user presses Ctrl-C again after more than one second, the
// program ends immediately.
#pragma once

namespace relidar::cli {

/// The handlers for SIGINT and SIGTERM only store the time of the signal.
void install_handlers();
bool is_interrupted();
/// @throws Error with exit code 130 after Ctrl-C
void check_interrupt();

}  // namespace relidar::cli
