// SPDX-License-Identifier: Apache-2.0
// Checks the nesting depth of a TOML text before it is parsed.
#pragma once

#include <string>
#include <string_view>

namespace relidar {

/// Rejects TOML text with too deep nesting. A TOML library creates one nested table per
/// part of a key and destroys the tables recursively. Therefore a key with forty thousand
/// dots would overflow the stack. Keys of our settings have two parts.
/// @param file_name file name for the error message
/// @throws DataError if a key has more than 8 parts, or if brackets are nested more than
/// 8 deep
void require_toml_nesting_within_limit(std::string_view toml_text, const std::string& file_name);

}  // namespace relidar
