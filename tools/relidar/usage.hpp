// SPDX-License-Identifier: Apache-2.0
// Creates the error message for an invalid command line. The message has one line and
// suggests the most similar command or option.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace relidar::cli {

/// Returns the error message for an invalid command line.
/// @param app parser after it has failed
/// @param what error message of the parser
std::string usage_message(const CLI::App& app, const std::string& what);

}  // namespace relidar::cli
