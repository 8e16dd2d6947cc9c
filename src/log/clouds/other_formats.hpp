// SPDX-License-Identifier: Apache-2.0
// Recognises file formats that relidar cannot read. Names the tools that convert these
// files.
#pragma once

#include <filesystem>
#include <string>

namespace relidar {

/// Returns a text that names the format of a file and a tool that converts it to a
/// supported format. Returns an empty string if the extension of the file is unknown.
std::string describe_unsupported_format(const std::filesystem::path& file);

/// Searches a folder for a file in a known format that is not supported, and returns a
/// text about the first one. Returns an empty string if there is none.
std::string describe_other_files(const std::filesystem::path& folder);

}  // namespace relidar
