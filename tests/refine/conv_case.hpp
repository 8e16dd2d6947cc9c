// SPDX-License-Identifier: Apache-2.0
// A convolution that tests of its kernels try, by floats and by matrix units.
#pragma once

#include <cstdint>
#include <ostream>

#include "refine/tensor.hpp"

namespace relidar::test {

struct ConvCase {
    std::uint32_t taps;
    refine::Grid grid;
    int n_in, n_out;
};

inline void PrintTo(const ConvCase& c, std::ostream* out) {
    *out << c.taps << " taps, " << c.grid.n << "x" << c.grid.rows << "x" << c.grid.columns << ", " << c.n_in << " -> " << c.n_out;
}

}  // namespace relidar::test
