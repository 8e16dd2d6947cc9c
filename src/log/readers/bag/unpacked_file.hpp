// SPDX-License-Identifier: Apache-2.0
// Opens recordings that were compressed with gzip.
#pragma once

#include <cstdio>
#include <filesystem>
#include <string>

namespace relidar::bag {

/// Returns the name that a file had before it was compressed: the path without ".gz".
std::filesystem::path unpacked_name(const std::filesystem::path& file);

/// A file that is open for reading. The caller must close it.
struct UnpackedFile {
    std::FILE* file = nullptr;
    std::string problem;  ///< text about a truncated gzip file; empty if the file is complete
};
/// Opens a file. If the file is compressed with gzip, unpacks it to a temporary file. The
/// system deletes the temporary file when it is closed.
/// @throws DataError if the file cannot be read or unpacked
UnpackedFile open_unpacked(const std::filesystem::path& file);

}  // namespace relidar::bag
