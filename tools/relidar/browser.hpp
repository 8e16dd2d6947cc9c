// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace relidar::cli {

/// Opens an address in the browser of the user, with xdg-open. If it is missing, prints a
/// note with the address.
void open_in_browser(const std::string& url_or_path);

}  // namespace relidar::cli
