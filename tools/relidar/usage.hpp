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
/// @param parser_message error message of the parser
std::string make_usage_error_message(const CLI::App& app, const std::string& parser_message);

}  // namespace relidar::cli
