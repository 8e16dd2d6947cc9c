// SPDX-License-Identifier: Apache-2.0
// Collects returns that hit the same small cell (place) in several sweeps or with several
// beams, because only their intensities can be compared. Used only in src/log/sequence.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// One return: index of the small cell ("place") that it hit, beam, range, angle of
/// incidence and intensity.
struct CellReturn {
    std::uint32_t cell;
    std::uint32_t beam;
    float range_m;
    float cosine;     ///< cosine of the angle of incidence
    float intensity;  ///< measured intensity
};

/// Returns in small cells ("places") that were hit at least twice, sorted by place.
/// Places have the numbers 0, 1, 2 and so on.
struct RepeatedCellReturns {
    std::vector<CellReturn> sorted_returns;
    std::size_t n_cells = 0;
};
RepeatedCellReturns collect_repeatedly_hit_cells(const LidarSequence& sequence,
                                                 const std::vector<int>& frame_indices);

}  // namespace relidar
