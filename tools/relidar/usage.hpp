// SPDX-License-Identifier: Apache-2.0
// Builds the error message for a command line that cannot be parsed. The message is one
// line and suggests the most similar command or option.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace relidar::cli {

/// Returns the error message for a failed parse.
/// @param app parser in the state after the failed parse
/// @param what message of the parser
std::string usage_message(const CLI::App& app, const std::string& what);

}  // namespace relidar::cli
