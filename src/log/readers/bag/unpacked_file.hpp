// SPDX-License-Identifier: Apache-2.0
// Opens recordings that were compressed with gzip or zstd.
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

/// Removes the extension ".zstd" or ".zst" from a path, if the path has this extension.
std::filesystem::path remove_zstd_extension(const std::filesystem::path& file);

/// A temporary unpacked copy of a file that was compressed with zstd. The destructor
/// deletes the copy. On Linux, programs that opened it before can still read it.
class UnpackedZstdFile {
public:
    /// Unpacks a file. Makes no copy of a file that does not begin like zstd data.
    /// @throws DataError if the file cannot be read or unpacked
    explicit UnpackedZstdFile(const std::filesystem::path& file);
    ~UnpackedZstdFile();
    UnpackedZstdFile(const UnpackedZstdFile&) = delete;
    UnpackedZstdFile& operator=(const UnpackedZstdFile&) = delete;

    /// Returns the path of the copy, or of the file itself if it is not compressed.
    const std::filesystem::path& path() const { return path_; }
    bool is_truncated() const { return is_truncated_; }

private:
    std::filesystem::path path_, temporary_folder_;
    bool is_truncated_ = false;
};

}  // namespace relidar::bag
