// SPDX-License-Identifier: Apache-2.0
// Checks TOML text before it is parsed.
#pragma once

#include <string>
#include <string_view>

namespace relidar {

/// Rejects TOML with too deep nesting. A TOML library creates nested tables for the parts
/// of a key and destroys them recursively, so that forty thousand dots overflow the
/// stack. Keys of settings have two parts.
/// @param file file name for the message
/// @throws DataError if a key has more than 8 parts, or brackets are nested more than 8
/// deep
void check_toml_depth(std::string_view text, const std::string& file);

}  // namespace relidar
