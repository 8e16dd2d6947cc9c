// SPDX-License-Identifier: Apache-2.0
// A file of which parts are read, and the chunks of it that were unpacked last.
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

/// Read from any thread.
class PartFile {
public:
    /// @throws DataError where it cannot be opened
    explicit PartFile(const std::filesystem::path& path);
    ~PartFile();
    PartFile(const PartFile&) = delete;
    PartFile& operator=(const PartFile&) = delete;

    std::uint64_t size() const { return size_; }
    const std::string& name() const { return name_; }
    /// @throws DataError where the file ends before
    SharedBytes part(std::uint64_t at, std::uint64_t n) const;

private:
    std::string name_;
    int handle_ = -1;
    std::uint64_t size_ = 0;
};

/// Unpacked chunks by the byte at which they begin; the newest few are kept, for messages
/// that lie in one are often read together.
class ChunkCache {
public:
    SharedBytes get(std::uint64_t at, const std::function<SharedBytes()>& unpack) const;

private:
    static constexpr std::size_t kKept = 2;
    mutable std::mutex lock_;
    mutable std::deque<std::pair<std::uint64_t, SharedBytes>> chunks_;
};

/// A chunk as its file compressed it: "", "none", "lz4", "zstd" or "bz2". A chunk that is
/// not compressed is not copied.
/// @param n  its size unpacked, as the file has it; refused before anything is allocated
/// where it cannot be
/// @throws DataError
SharedBytes unpack_chunk(std::string_view compression, const SharedBytes& chunk, std::uint64_t n);

}  // namespace relidar::bag
