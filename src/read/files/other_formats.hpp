// SPDX-License-Identifier: Apache-2.0
// Recognises file formats that relidar cannot read. Names tools that convert them.
#pragma once

#include <filesystem>
#include <string>

namespace relidar {

/// Returns the name of the format and a tool that converts it, or an empty string.
std::string describe_format(const std::filesystem::path& file);

/// Describes the first file of a folder that relidar cannot read, or returns an empty
/// string.
std::string find_unsupported(const std::filesystem::path& folder);

}  // namespace relidar
