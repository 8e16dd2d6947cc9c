// SPDX-License-Identifier: Apache-2.0
// Decompresses lz4 and zstd data. The caller must know the uncompressed size.
#pragma once

#include <span>
#include <string_view>

namespace relidar {

/// Decompresses one lz4 frame into `to`. The size of `to` must be the uncompressed size.
/// @throws DataError if the frame is damaged or has another size
void unpack_lz4(std::string_view from, std::span<char> to);
/// Decompresses one zstd frame into `to`. The size of `to` must be the uncompressed size.
/// @throws DataError if the frame is damaged or has another size
void unpack_zstd(std::string_view from, std::span<char> to);

}  // namespace relidar
