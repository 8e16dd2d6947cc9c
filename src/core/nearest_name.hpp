// SPDX-License-Identifier: Apache-2.0
// The known name that a mistyped one was most likely meant to be, for error messages.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Known name with the smallest edit distance (insert, delete, replace; case ignored) to `wanted`.
/// @return empty where `known` is empty; the first of equals
std::string nearest_name(std::string_view wanted, const std::vector<std::string>& known);

}  // namespace relidar
