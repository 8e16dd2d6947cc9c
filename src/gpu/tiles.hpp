// SPDX-License-Identifier: Apache-2.0
// Defines the workgroup size of kernels that process tiles of items, and computes the
// number of tiles for n items.
#pragma once

#include "gpu/kernel.hpp"

namespace relidar {

inline constexpr SpecialisationConstant kTileWorkgroup{SpecialisationConstantId::WORKGROUP_SIZE,
                                                       RELIDAR_TILE_THREADS};

inline std::size_t count_tiles(std::size_t n_items) {
    return (n_items + RELIDAR_TILE_SIZE - 1) / RELIDAR_TILE_SIZE;
}

}  // namespace relidar
