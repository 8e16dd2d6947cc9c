// SPDX-License-Identifier: Apache-2.0
// Decompresses lz4 and zstd data, which may consist of several frames, and chunks of the
// format Blosc 1 with the codec LZ4.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <string_view>

namespace relidar {

/// Decompresses frames. `uncompressed_bytes` must have exactly the uncompressed size.
/// @throws DataError if the data are damaged or have a different uncompressed size
void decompress_lz4(std::string_view compressed_bytes, std::span<char> uncompressed_bytes);
void decompress_zstd(std::string_view compressed_bytes, std::span<char> uncompressed_bytes);

/// Returns the uncompressed bytes of a Blosc chunk, with its byte or bit shuffle undone.
/// @throws DataError if the chunk is truncated or damaged, or uses another codec
std::string decompress_blosc(std::string_view chunk);

constexpr std::string_view kZstdMagic("\x28\xb5\x2f\xfd", 4);  ///< first bytes of a zstd frame
/// Decompresses zstd frames of unknown size.
/// @param read_block  returns the next compressed bytes; empty at the end
/// @param write_block  receives uncompressed bytes
/// @return false if the last frame is truncated
/// @throws DataError if the data are damaged
bool stream_zstd(const std::function<std::string_view()>& read_block,
                 const std::function<void(std::string_view)>& write_block);

}  // namespace relidar
