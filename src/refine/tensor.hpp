// SPDX-License-Identifier: Apache-2.0
// Images on the device: [n, channels, rows, columns], columns fastest. Columns are a ring.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <relidar/stages/gpu.hpp>
#include "gpu/kernel.hpp"

#include "shared/refine.h"

namespace relidar::refine {

/// Rows and columns of n images.
struct Grid {
    std::uint32_t n = 0, rows = 0, columns = 0;

    std::size_t pixels() const { return std::size_t(rows) * columns; }   ///< of an image
    std::size_t all_pixels() const { return n * pixels(); }
    friend bool operator==(const Grid&, const Grid&) = default;
};

/// So many of `size` hold n.
inline std::uint32_t tiles(std::uint32_t n, std::uint32_t size) { return (n + size - 1) / size; }

/// What images are kept as; what is computed from them are floats in both.
enum class Storage { fp32, fp16 };

/// By name: "fp32" or "fp16". @throws UsageError for another one
Storage find_storage(const std::string& name);
/// The same, of a device. @throws DeviceError naming what it lacks
Storage checked(const Device& device, Storage storage);
/// Name of the variant of a kernel whose images are kept so.
KernelVariant image_variant(Storage storage);

/// Some consecutive channels of a tensor.
struct Slice {
    shared::ImageSlice view;
    std::uint32_t channels = 0;
    Grid grid;

    Slice part(std::uint32_t first, std::uint32_t n) const {
        return {{view.values, view.channels, view.first + first}, n, grid};
    }
};

struct Tensor {
    std::uint32_t channels = 0;
    Grid grid;
    Array<float> values;            ///< of Storage::fp32, otherwise empty
    Array<std::uint16_t> halves;    ///< of Storage::fp16, otherwise empty

    Tensor() = default;
    Tensor(Device& device, std::uint32_t n_channels, const Grid& g, Storage storage, const std::string& what)
        : channels(n_channels), grid(g) {
        const std::size_t n = n_channels * g.all_pixels();
        if (storage == Storage::fp16) halves = Array<std::uint16_t>(device, n, what);
        else values = Array<float>(device, n, what);
    }
    Storage storage() const { return halves.size() > 0 ? Storage::fp16 : Storage::fp32; }
    Address<shared::ImageValue> address() const {
        return halves.size() > 0 ? halves.address_as<shared::ImageValue>() : values.address_as<shared::ImageValue>();
    }
    Slice all() const { return {{address(), channels, 0}, channels, grid}; }
    const Buffer& buffer() const { return halves.size() > 0 ? halves.buffer() : values.buffer(); }
    std::size_t size_bytes() const { return halves.size() * sizeof(std::uint16_t) + values.size() * sizeof(float); }
};

}  // namespace relidar::refine
