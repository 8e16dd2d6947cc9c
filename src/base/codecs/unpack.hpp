// SPDX-License-Identifier: Apache-2.0
// Compressed parts of files, of whose size the file says what they have unpacked.
#pragma once

#include <span>
#include <string_view>

namespace relidar {

/// Fills `to`, as long as the file says, from one lz4 frame. @throws DataError where the
/// frame is damaged or of another size
void unpack_lz4(std::string_view from, std::span<char> to);
/// The same from one zstd frame.
void unpack_zstd(std::string_view from, std::span<char> to);

}  // namespace relidar
