// SPDX-License-Identifier: Apache-2.0
// Decompresses chunks of the format Blosc 1 with the codec LZ4.
#pragma once

#include <string>
#include <string_view>

namespace relidar {

/// Returns the uncompressed bytes of a Blosc chunk, with its byte or bit shuffle undone.
/// @throws DataError if the chunk is truncated or damaged, or uses another codec
std::string decompress_blosc(std::string_view chunk);

}  // namespace relidar
