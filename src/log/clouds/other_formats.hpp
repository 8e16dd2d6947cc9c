// SPDX-License-Identifier: Apache-2.0
// Names the file formats that relidar does not read, and the tools that convert them.
#pragma once

#include <filesystem>
#include <string>

namespace relidar {

/// Returns what a file is and which tool converts it to a format that relidar reads.
/// Returns an empty string if the file's ending is not known.
std::string describe_other_format(const std::filesystem::path& file);

/// Describes the first file of a folder whose format is known but not supported. Returns
/// an empty string if the folder has none.
std::string describe_other_files(const std::filesystem::path& folder);

}  // namespace relidar
