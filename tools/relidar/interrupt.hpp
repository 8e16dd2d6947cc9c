// SPDX-License-Identifier: Apache-2.0
// Ctrl-C ends long work in order: finished files stay, the rest stops at the next safe
// point. Another Ctrl-C a second later or more ends at once.
#pragma once

namespace relidar::cli {

/// From now on SIGINT and SIGTERM are remembered instead of ending the program.
void catch_interrupts();
bool interrupted();
/// @throws Error with exit code 130 where the user has interrupted
void stop_if_interrupted();

}  // namespace relidar::cli
