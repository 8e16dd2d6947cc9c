// SPDX-License-Identifier: Apache-2.0
// Files of the web page of `relidar view`, compiled into the program. They come from
// tools/view/page and src/score/report/points.
#pragma once

#include <vector>

#include "server.hpp"

namespace relidar::view {

/// Returns all files of the page. Their texts are valid until the program ends.
const std::vector<Asset>& page_assets();

}  // namespace relidar::view
