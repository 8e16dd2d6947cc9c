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

/// Returns a text about the first file of a folder whose format relidar knows but cannot
/// read. Returns an empty string if the folder has no such file.
std::string describe_unsupported_file_in(const std::filesystem::path& folder);

}  // namespace relidar
