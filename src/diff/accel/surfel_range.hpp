// SPDX-License-Identifier: Apache-2.0
// Range of surfels whose boxes a refit updates.
#pragma once

#include <cstdint>
#include <vector>

namespace relidar {

/// Range of surfel indices. Contains all surfels of one model, or of several consecutive
/// models.
struct SurfelRange {
    std::uint32_t first = 0, count = 0;

    bool contains_surfel(std::uint32_t surfel) const { return surfel - first < count; }
};
using SurfelRanges = std::vector<SurfelRange>;

}  // namespace relidar
