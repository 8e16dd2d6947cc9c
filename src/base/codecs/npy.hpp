// SPDX-License-Identifier: Apache-2.0
// Writes and parses .npy data, the format of each array in an npz file: magic, version,
// and a Python dict with type, order and shape. Private to base/codecs.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::export_detail {

/// Returns the header (version 1.0) of an array, padded to a multiple of 64 bytes.
std::string npy_header(const NamedArray& array);

/// Parses the bytes of a .npy file of versions 1 to 3, little-endian and row-major.
/// @throws DataError with the reason if the file has any other form
NamedArray parse_npy(const std::string& name, const std::vector<std::byte>& bytes);

}  // namespace relidar::export_detail
