// SPDX-License-Identifier: Apache-2.0
// The .npy header, one entry of an npz file: magic, version, and a Python dict of type,
// order and shape. Private to export.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::export_detail {

/// Header (version 1.0) of an array, padded to a multiple of 64 bytes.
std::string npy_header(const NamedArray& array);

/// Array from the bytes of a .npy file: versions 1 to 3, little-endian, row-major.
/// @throws DataError for anything else, saying what it is
NamedArray parse_npy(const std::string& name, const std::vector<std::byte>& bytes);

}  // namespace relidar::export_detail
