// SPDX-License-Identifier: Apache-2.0
// Arrays of images on the device, [n, channels, rows, columns]. Neighbouring columns are
// adjacent in memory. Columns wrap around.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <relidar/gpu/stream.hpp>
#include "gpu/kernel.hpp"

#include "diff/shared/refine.h"

namespace relidar::refine {

/// Number of images, and rows and columns of each image.
struct Grid {
    std::uint32_t n = 0, rows = 0, columns = 0;

    std::size_t pixels() const { return std::size_t(rows) * columns; }  ///< pixels of one image
    std::size_t all_pixels() const { return n * pixels(); }
    friend bool operator==(const Grid&, const Grid&) = default;
};

/// Returns how many groups of `size` elements are needed for `count` elements.
inline std::uint32_t count_groups_of(std::uint32_t count, std::uint32_t size) {
    return (count + size - 1) / size;
}

/// View of consecutive channels of a tensor.
struct Slice {
    shared::ImageSlice view;
    std::uint32_t channels = 0;
    Grid grid;

    Slice part(std::uint32_t first, std::uint32_t count) const {
        return {{view.values, view.channels, view.first + first}, count, grid};
    }
};

struct Tensor {
    std::uint32_t channels = 0;
    Grid grid;
    Array<float> values;

    Tensor() = default;
    Tensor(Device& device, std::uint32_t n_channels, const Grid& g, const std::string& description)
        : channels(n_channels), grid(g), values(device, n_channels * g.all_pixels(), description) {}
    Slice all() const { return {{values.address(), channels, 0}, channels, grid}; }
};

}  // namespace relidar::refine
