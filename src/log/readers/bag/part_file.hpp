// SPDX-License-Identifier: Apache-2.0
// Reads parts of a file. Also unpacks compressed chunks and caches the latest ones.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <utility>

#include "base/shared_bytes.hpp"

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
    SharedBytes get_or_unpack_chunk(std::uint64_t chunk_offset,
                                    const std::function<SharedBytes()>& unpack) const;

private:
    static constexpr std::size_t kMaxCachedChunks = 2;
    mutable std::mutex lock_;
    mutable std::deque<std::pair<std::uint64_t, SharedBytes>> chunks_;
};

/// Unpacks a chunk. The compression is "", "none", "lz4", "zstd" or "bz2". Uncompressed
/// chunks are not copied.
/// @param unpacked_size  unpacked size according to the file. Impossible sizes are
/// rejected before memory is allocated
/// @throws DataError if the chunk is damaged
SharedBytes unpack_chunk(std::string_view compression, const SharedBytes& compressed_chunk,
                         std::uint64_t unpacked_size);

}  // namespace relidar::bag
