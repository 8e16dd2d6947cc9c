// SPDX-License-Identifier: Apache-2.0
// .npy data: magic bytes, a version, a header with type, order and shape, and the values.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::codecs {

/// Version 1.0, padded to a multiple of 64 bytes.
std::string make_npy_header(const NamedArray& array);

/// Supports versions 1 to 3.
/// @throws DataError with the reason for any other version, type or order
NamedArray parse_npy(const std::string& name, const std::vector<std::byte>& bytes);

}  // namespace relidar::codecs
