// SPDX-License-Identifier: Apache-2.0
// Collects returns that hit the same grid cell in several sweeps or with several beams,
// because only their intensities can be compared. Used only in src/log/sequence.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// A return in a grid cell. Intensities of returns in the same cell are compared.
struct CellReturn {
    std::uint32_t cell;
    std::uint32_t beam;
    float range_m;
    float cosine;     ///< cosine of the angle of incidence
    float intensity;  ///< measured intensity
};

/// LiDAR returns, sorted by grid cell. Cells with a single return are left out. Cell
/// indices range from 0 to n_cells - 1, with gaps.
struct CellReturns {
    std::vector<CellReturn> sorted_returns;
    std::size_t n_cells = 0;
};
CellReturns collect_cells(const Log& sequence, const std::vector<int>& frames);

}  // namespace relidar
