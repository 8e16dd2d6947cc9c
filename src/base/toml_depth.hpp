// SPDX-License-Identifier: Apache-2.0
// A look at TOML text before it is parsed.
#pragma once

#include <string>
#include <string_view>

namespace relidar {

/// A TOML library makes a table of every part of a key, one in the other, and takes them
/// down again by recursion: forty thousand dots overflow the stack. Settings have two
/// parts.
/// @param file for the message @throws DataError where a key has more than 8 parts, or
/// brackets lie more than 8 deep
void check_toml_depth(std::string_view text, const std::string& file);

}  // namespace relidar
