// SPDX-License-Identifier: Apache-2.0
// Recognises file formats that relidar cannot read. Names tools that convert them.
#pragma once

#include <filesystem>
#include <string>

namespace relidar {

/// Returns a text that names the format of a file and a tool that converts it to a
/// supported format. Returns an empty string if the extension of the file is unknown.
std::string describe_unsupported_format(const std::filesystem::path& file);

/// Searches a folder for a file in a known format that relidar cannot read. Returns a
/// text about the first such file, or an empty string.
std::string describe_unsupported_file_in(const std::filesystem::path& folder);

}  // namespace relidar
