// SPDX-License-Identifier: Apache-2.0
// Small surface patches ("places") that several sweeps or beams have hit, for comparing
// intensities. Private to sequence.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// One return: its place, beam, range, incidence and intensity.
struct PlaceReturn {
    std::uint32_t place;
    std::uint32_t beam;
    float range_m;
    float cosine;     ///< cosine of the angle of incidence
    float intensity;  ///< as measured
};

/// Returns of the frames at some positions, from places on a surface that were hit at
/// least twice. Sorted by place. Places are numbered from 0.
struct PlaceReturns {
    std::vector<PlaceReturn> seen;
    std::size_t n_places = 0;
};
PlaceReturns returns_of_places(const Sequence& sequence, const std::vector<int>& positions);

}  // namespace relidar
