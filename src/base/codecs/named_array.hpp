// SPDX-License-Identifier: Apache-2.0
// Checks of arrays that npz and safetensors share. Private to base/codecs.
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::export_detail {

/// Returns the bytes per element of a type; 0 for a type that NamedArray does not
/// support.
std::size_t item_size(std::string_view dtype);

/// Returns the number of bytes of an array with this shape; nullopt if it exceeds the
/// address space.
std::optional<std::size_t> byte_count(const std::vector<std::size_t>& shape, std::size_t item_size);

/// Checks the name, type and size of an array.
/// @throws DataError if the array has no name or an unknown type, or if the number of
/// bytes does not match its shape
void check_array(const NamedArray& array);

}  // namespace relidar::export_detail
