// SPDX-License-Identifier: Apache-2.0
// Decompresses lz4 and zstd data. The caller must know the uncompressed size.
#pragma once

#include <span>
#include <string_view>

namespace relidar {

/// Decompresses one lz4 frame into `target`. `target` must have exactly the uncompressed
/// size.
/// @throws DataError if the frame is damaged or has a different uncompressed size
void unpack_lz4(std::string_view packed, std::span<char> target);
/// Decompresses one zstd frame into `target`. `target` must have exactly the uncompressed
/// size.
/// @throws DataError if the frame is damaged or has a different uncompressed size
void unpack_zstd(std::string_view packed, std::span<char> target);

}  // namespace relidar
