// SPDX-License-Identifier: Apache-2.0
// What to say about a command line that cannot be parsed: one line, with the nearest
// known command or option.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace relidar::cli {

/// @param app as the failed parse left it @param what the parser's own message
std::string usage_message(const CLI::App& app, const std::string& what);

}  // namespace relidar::cli
