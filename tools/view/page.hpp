// SPDX-License-Identifier: Apache-2.0
// The page of `relidar view`, compiled into the program: tools/view/page and the modules
// of src/score/report/points.
#pragma once

#include <vector>

#include "server.hpp"

namespace relidar::view {

/// All there is to serve. The texts live as long as the program.
const std::vector<Asset>& page_assets();

}  // namespace relidar::view
