// SPDX-License-Identifier: Apache-2.0
// Shows a page to whoever sits at this machine.
#pragma once

#include <string>

namespace relidar::cli {

/// Opens an address or a file in the user's browser; says so where there is none.
void open_in_browser(const std::string& address);

}  // namespace relidar::cli
