// SPDX-License-Identifier: Apache-2.0
// Decompresses lz4 and zstd data. The caller must know the uncompressed size.
#pragma once

#include <span>
#include <string_view>

namespace relidar {

/// Decompresses one lz4 frame into `uncompressed_bytes`. `uncompressed_bytes` must have
/// exactly the uncompressed size.
/// @throws DataError if the frame is damaged or has a different uncompressed size
void decompress_lz4(std::string_view compressed_bytes, std::span<char> uncompressed_bytes);
/// Decompresses one zstd frame into `uncompressed_bytes`. `uncompressed_bytes` must have
/// exactly the uncompressed size.
/// @throws DataError if the frame is damaged or has a different uncompressed size
void decompress_zstd(std::string_view compressed_bytes, std::span<char> uncompressed_bytes);

}  // namespace relidar
