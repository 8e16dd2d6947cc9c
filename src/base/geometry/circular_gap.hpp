// SPDX-License-Identifier: Apache-2.0
// Finds the widest gap between the filled bins of a circle.
#pragma once

#include <cstddef>

namespace relidar {

/// Consecutive empty bins of a circle.
struct CircularGap {
    std::size_t length = 0;
    std::size_t end = 0;  ///< first bin after the gap, plus the number of bins if it wraps around
};

/// Returns the widest gap. Its length is at least `n_bins` if all bins are empty.
/// @param is_filled  function of a bin
template <class IsFilled>
CircularGap find_widest_gap(std::size_t n_bins, const IsFilled& is_filled) {
    CircularGap widest;
    std::size_t length = 0;
    // Counts every bin twice, because a gap may contain the start of the circle.
    for (std::size_t b = 0; b < 2 * n_bins; ++b) {
        length = is_filled(b % n_bins) ? 0 : length + 1;
        if (length > widest.length) widest = {length, b + 1};
    }
    return widest;
}

}  // namespace relidar
