// SPDX-License-Identifier: Apache-2.0
// The web page of `relidar view`, compiled into the program: tools/view/page and the
// modules of src/score/report/points.
#pragma once

#include <vector>

#include "server.hpp"

namespace relidar::view {

/// Returns all files of the page. Their texts live as long as the program.
const std::vector<Asset>& page_assets();

}  // namespace relidar::view
