// SPDX-License-Identifier: Apache-2.0
// Checks the nesting depth of a TOML text before it is parsed.
#pragma once

#include <string>
#include <string_view>

namespace relidar {

/// A TOML library destroys nested tables recursively, so a key with forty thousand dots
/// would overflow the stack. Keys of our settings have two parts.
void check_toml_depth(std::string_view toml_text, const std::string& name);

}  // namespace relidar
