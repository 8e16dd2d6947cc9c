// SPDX-License-Identifier: Apache-2.0
// Writes and parses .npy data, which an npz file contains for each array. The data
// consists of magic bytes, a version, a header with type, order and shape, and the
// values.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::report_detail {

/// Returns the .npy header (version 1.0) of an array, padded to a multiple of 64 bytes.
std::string make_npy_header(const NamedArray& array);

/// Parses the bytes of a .npy file. Supports versions 1 to 3, little-endian numbers and
/// row-major order.
/// @throws DataError with the reason if the file uses any other version, type or order
NamedArray parse_npy(const std::string& array_name, const std::vector<std::byte>& bytes);

}  // namespace relidar::report_detail
