// SPDX-License-Identifier: Apache-2.0
// Collects returns that hit the same small cell (place) in several sweeps or with several
// beams. The intensities of such returns can be compared. Used only in src/log/sequence.
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

/// Returns from small cells ("places") that were hit at least twice, sorted by place.
/// Places are numbered from 0.
struct RepeatedCellReturns {
    std::vector<CellReturn> sorted_returns;
    std::size_t n_cells = 0;
};
RepeatedCellReturns collect_returns_by_cell(const LidarSequence& sequence,
                                            const std::vector<int>& frame_indices);

}  // namespace relidar
