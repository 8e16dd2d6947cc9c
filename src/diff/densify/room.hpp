// SPDX-License-Identifier: Apache-2.0
// Whether device memory holds out, tried before anything is moved: what does not fit is
// never half allocated. Private to densify.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include <relidar/base/error.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

/// Whether so many bytes can be had now, in pieces. @return empty, or why not
inline std::string missing_memory(Device& device, double n_bytes) {
    constexpr double kPiece = double(256 << 20);  // drivers limit single allocations, not only their sum
    std::vector<Buffer> pieces;
    try {
        for (; n_bytes > 0.0; n_bytes -= kPiece)
            pieces.emplace_back(device, static_cast<std::size_t>(std::min(std::max(n_bytes, 4.0), kPiece)),
                                "more surfels");
    } catch (const DeviceError& error) {
        return error.what();
    }
    return {};
}

}  // namespace relidar
