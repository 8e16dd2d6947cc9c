// SPDX-License-Identifier: Apache-2.0
// Opens recordings that were compressed with gzip.
#pragma once

#include <cstdio>
#include <filesystem>
#include <string>

namespace relidar::bag {

/// Removes the extension ".gz" from a path, if the path has this extension.
std::filesystem::path remove_gz_extension(const std::filesystem::path& file);

/// A file that is open for reading. If it was compressed with gzip, this is the unpacked
/// file. The caller must close it.
struct DecompressedFile {
    std::FILE* file = nullptr;
    std::string problem;  ///< text about a truncated gzip file; empty if the file is complete
};
/// Opens a file. Unpacks a gzip file to a temporary file first, which the system deletes
/// when it is closed.
/// @throws DataError if the file cannot be read or unpacked
DecompressedFile open_file_and_unpack_gzip(const std::filesystem::path& file);

}  // namespace relidar::bag
