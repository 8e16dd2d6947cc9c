// SPDX-License-Identifier: Apache-2.0
// What several sweeps or beams have seen of the same small places, for comparing
// intensities. Private to sequence.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// One return: from which place, by which beam, how far, how squarely, how bright.
struct PlaceReturn {
    std::uint32_t place;
    std::uint32_t beam;
    float range_m;
    float cosine;     ///< of the angle of incidence
    float intensity;  ///< as measured
};

/// Returns of frames at some positions, of places on a surface that are hit twice or
/// more; in the order of the places, which are numbered from 0.
struct PlaceReturns {
    std::vector<PlaceReturn> seen;
    std::size_t n_places = 0;
};
PlaceReturns returns_of_places(const Sequence& sequence, const std::vector<int>& positions);

}  // namespace relidar
