// SPDX-License-Identifier: Apache-2.0
// Arrays of images on the device, [n, channels, rows, columns]. Neighbouring columns are
// adjacent in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <relidar/gpu/stream.hpp>
#include "gpu/kernel.hpp"

#include "diff/shared/refine.h"

namespace relidar::network {

struct ImageBatchSize {
    std::uint32_t n = 0, rows = 0, columns = 0;
    bool circular = true;  ///< true: columns wrap around, because the image covers a full turn

    std::size_t n_image_pixels() const { return std::size_t(rows) * columns; }
    std::size_t n_pixels_total() const { return n * n_image_pixels(); }
    friend bool operator==(const ImageBatchSize&, const ImageBatchSize&) = default;
};

inline std::uint32_t div_ceil(std::uint32_t count, std::uint32_t group_size) {
    return (count + group_size - 1) / group_size;
}

struct Slice {
    shared::ImageSlice view;
    std::uint32_t channels = 0;
    ImageBatchSize grid;

    Slice channel_range(std::uint32_t first_channel, std::uint32_t n_channels) const {
        return {{view.values, view.channels, view.first + first_channel}, n_channels, grid};
    }
};

struct Tensor {
    std::uint32_t channels = 0;
    ImageBatchSize grid;
    Array<float> values;

    Tensor() = default;
    Tensor(Device& device, std::uint32_t n_channels, ImageBatchSize g, const std::string& text)
        : channels(n_channels), grid(g), values(device, n_channels * g.n_pixels_total(), text) {}
    /// Returns all channels.
    operator Slice() const { return {{values.address(), channels, 0}, channels, grid}; }
    Slice channel_range(std::uint32_t first_channel, std::uint32_t n_channels) const {
        return Slice(*this).channel_range(first_channel, n_channels);
    }
};

}  // namespace relidar::network
