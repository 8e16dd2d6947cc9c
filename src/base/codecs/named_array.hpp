// SPDX-License-Identifier: Apache-2.0
// What npz and safetensors need to know of an array before they trust it. Private to
// export.
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>
#include <vector>

#include <relidar/base/arrays.hpp>

namespace relidar::export_detail {

/// Bytes an element of a type takes; 0 for a type NamedArray does not know.
std::size_t item_size(std::string_view dtype);

/// Bytes of an array of a shape; nothing where that exceeds the address space.
std::optional<std::size_t> byte_count(const std::vector<std::size_t>& shape, std::size_t item_size);

/// @throws DataError for an array without name, of unknown type, or whose bytes do not
/// fill its shape
void check_array(const NamedArray& array);

}  // namespace relidar::export_detail
