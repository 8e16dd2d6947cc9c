// SPDX-License-Identifier: Apache-2.0
// Files of the web page of `relidar view`. They are compiled into the program from
// tools/view/page and src/score/report/points.
#pragma once

#include <vector>

#include "server.hpp"

namespace relidar::view {

/// The texts stay valid until the program ends.
const std::vector<WebPageFile>& get_web_page_files();

}  // namespace relidar::view
