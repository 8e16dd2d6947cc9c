// SPDX-License-Identifier: Apache-2.0
// What kernels that work in tiles share: the workgroup of a tile, and how many tiles hold
// n items.
#pragma once

#include <cstddef>

#include "gpu/kernel.hpp"

namespace relidar {

inline constexpr Constant kTileWorkgroup{ConstantId::WORKGROUP_SIZE, RELIDAR_TILE_THREADS};

inline std::size_t tiles_of(std::size_t n) { return (n + RELIDAR_TILE_SIZE - 1) / RELIDAR_TILE_SIZE; }

}  // namespace relidar
