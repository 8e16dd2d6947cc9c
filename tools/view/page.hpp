// SPDX-License-Identifier: Apache-2.0
// Files of the web page, compiled into the program.
#pragma once

#include "server.hpp"

namespace relidar::view {

const std::vector<WebPageFile>& web_page_files();

}  // namespace relidar::view
