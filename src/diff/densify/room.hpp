// SPDX-License-Identifier: Apache-2.0
// Checks whether enough device memory is free. The check runs before any array is moved,
// so that a failed densification changes nothing. Used only by densification.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

/// Returns an empty string, or the reason why the allocation failed.
inline std::string try_allocation_and_get_error(Device& device, double n_bytes) {
    // allocates in pieces, because drivers limit the size of one allocation
    constexpr double kPiece = double(256 << 20);
    std::vector<Buffer> pieces;
    try {
        for (; n_bytes > 0.0; n_bytes -= kPiece)
            pieces.emplace_back(device, static_cast<std::size_t>(std::min(std::max(n_bytes, 4.0), kPiece)),
                                "additional surfels");
    } catch (const OutOfDeviceMemory& error) {
        return error.what();
    }
    return {};
}

}  // namespace relidar
