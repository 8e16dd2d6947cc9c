// SPDX-License-Identifier: Apache-2.0
// Checks arrays for the npz and safetensors codecs.
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>

#include <relidar/base/arrays.hpp>

namespace relidar::codecs {

/// Returns the number of bytes per element, or 0 if NamedArray does not support the type.
std::size_t element_bytes(std::string_view numpy_type);

/// Returns the size of an array, or nullopt if it does not fit into std::size_t.
std::optional<std::size_t> array_bytes(const ArrayShape& shape, std::size_t element_size_bytes);

/// @throws DataError if the array has no name, an unknown type, or a number of bytes that
/// does not match its shape
void check_array(const NamedArray& array);

}  // namespace relidar::codecs
