// SPDX-License-Identifier: Apache-2.0
// Opens a web page or file in the user's browser.
#pragma once

#include <string>

namespace relidar::cli {

/// Opens a URL or a file with xdg-open. Prints a note with the address if xdg-open is
/// missing.
void open_in_browser(const std::string& address);

}  // namespace relidar::cli
