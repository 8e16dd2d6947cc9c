// SPDX-License-Identifier: Apache-2.0
// Reads parts of a file, compressed chunks, and files that were compressed with gzip or
// zstd.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>

#include "base/bytes.hpp"
#include "read/files/recording.hpp"

namespace relidar::bag {

/// A file that is open for reading. Several threads can read it at the same time.
class RandomAccessFile {
public:
    /// Opens a file for reading.
    /// @throws DataError if the file cannot be opened
    explicit RandomAccessFile(const std::filesystem::path& path);
    ~RandomAccessFile();
    RandomAccessFile(const RandomAccessFile&) = delete;
    RandomAccessFile& operator=(const RandomAccessFile&) = delete;

    std::uint64_t size() const { return size_; }
    const std::string& name() const { return name_; }
    /// Reads `n_bytes` bytes at a byte offset of the file.
    /// @throws DataError if the file is too short
    SharedBytes read_bytes_at(std::uint64_t offset, std::uint64_t n_bytes) const;

private:
    std::string name_;
    int handle_ = -1;
    std::uint64_t size_ = 0;
};

/// Caches the last unpacked chunks by their byte offset. A few chunks are enough, because
/// the messages of a chunk are usually read one after another.
class ChunkCache {
public:
    /// Returns the unpacked chunk at a byte offset. Calls unpack() if it is not in the
    /// cache.
    SharedBytes find_or_unpack(std::uint64_t chunk_offset, const std::function<SharedBytes()>& unpack) const;

private:
    static constexpr std::size_t kMaxCachedChunks = 2;
    mutable std::mutex lock_;
    mutable std::deque<std::pair<std::uint64_t, SharedBytes>> chunks_;
};

/// Unpacks a chunk. Does not copy uncompressed chunks.
/// @param compression  "", "none", "lz4", "zstd" or "bz2"
/// @param size  according to the file; impossible sizes are rejected
/// @throws DataError if the chunk is damaged
SharedBytes unpack_chunk(std::string_view compression, const SharedBytes& chunk, std::uint64_t size);

/// A temporary unpacked copy of a file that was compressed with gzip or zstd. The
/// destructor deletes the copy. On Linux, programs that opened it before can still read
/// it.
class UnpackedFile {
public:
    /// Unpacks a file. Makes no copy of a file that does not begin like compressed data.
    /// @throws DataError if the file cannot be unpacked
    explicit UnpackedFile(const std::filesystem::path& file);
    ~UnpackedFile();
    UnpackedFile(const UnpackedFile&) = delete;
    UnpackedFile& operator=(const UnpackedFile&) = delete;

    /// Returns the path of the copy, or of the file itself if it is not compressed.
    const std::filesystem::path& path() const { return path_; }
    bool is_truncated() const { return is_truncated_; }

private:
    std::filesystem::path path_, temporary_folder_;
    bool is_truncated_ = false;
};

}  // namespace relidar::bag
