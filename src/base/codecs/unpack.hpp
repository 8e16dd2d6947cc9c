// SPDX-License-Identifier: Apache-2.0
// Decompresses data whose uncompressed size is stored in the file.
#pragma once

#include <span>
#include <string_view>

namespace relidar {

/// Decompresses one lz4 frame into `to`, which must have the uncompressed size.
/// @throws DataError if the frame is damaged or has another size
void unpack_lz4(std::string_view from, std::span<char> to);
/// Decompresses one zstd frame into `to`, which must have the uncompressed size.
/// @throws DataError if the frame is damaged or has another size
void unpack_zstd(std::string_view from, std::span<char> to);

}  // namespace relidar
