// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/part_file.hpp"

#include <algorithm>
#include <cerrno>
#include <climits>
#include <system_error>

#include <bzlib.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/codecs/unpack.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar::bag {
namespace {

/// If a chunk unpacks to more than kMostUnpacked times its packed size, it is damaged.
/// Point clouds usually unpack to three times their size. Sizes up to kAlwaysUnpacked
/// bytes are always accepted.
constexpr std::uint64_t kMostUnpacked = 8, kAlwaysUnpacked = std::uint64_t(8) << 20;

void unpack_bz2(std::string_view source, std::span<char> target) {
    unsigned n = unsigned(target.size());
    const int code = source.size() > UINT_MAX
                         ? BZ_PARAM_ERROR
                         : BZ2_bzBuffToBuffDecompress(target.data(), &n, const_cast<char*>(source.data()),
                                                      unsigned(source.size()), 0, 0);
    if (code != BZ_OK || n != target.size())
        fail("the bz2 data is damaged, expected {} bytes after unpacking", target.size());
}

using ChunkUnpacker = void (*)(std::string_view, std::span<char>);

std::string get_system_error_text() { return std::error_code(errno, std::generic_category()).message(); }

}  // namespace

RandomAccessFile::RandomAccessFile(const std::filesystem::path& path) : name_(path.string()) {
    handle_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (handle_ < 0) fail("{}: the file cannot be opened: {}", name_, get_system_error_text());
    struct stat status {};
    if (::fstat(handle_, &status) != 0 || !S_ISREG(status.st_mode)) {
        ::close(handle_);
        fail("{}: this path is not a regular file", name_);
    }
    size_ = std::uint64_t(status.st_size);
}

RandomAccessFile::~RandomAccessFile() { ::close(handle_); }

SharedBytes RandomAccessFile::read_bytes_at(std::uint64_t offset, std::uint64_t n_bytes) const {
    if (offset > size_ || n_bytes > size_ - offset)
        fail("the file is truncated: it has {} bytes after byte {}, expected {} bytes",
             size_ - std::min(offset, size_), offset, n_bytes);
    return allocate_shared_bytes(std::size_t(n_bytes), [&](std::span<char> bytes) {
        for (std::size_t got = 0; got < bytes.size();) {
            const ssize_t k = ::pread(handle_, bytes.data() + got, bytes.size() - got, off_t(offset + got));
            if (k < 0 && errno == EINTR) continue;
            if (k <= 0)
                fail("cannot read {} bytes that start at byte {}: {}", n_bytes, offset,
                     k < 0 ? get_system_error_text() : "the file has become shorter since it was opened");
            got += std::size_t(k);
        }
    });
}

SharedBytes ChunkCache::get_or_unpack_chunk(std::uint64_t chunk_offset,
                                            const std::function<SharedBytes()>& unpack) const {
    const auto find_cached_chunk = [&] {
        return std::find_if(chunks_.begin(), chunks_.end(),
                            [&](const auto& chunk) { return chunk.first == chunk_offset; });
    };
    {
        const std::lock_guard guard(lock_);
        if (const auto cached_chunk = find_cached_chunk(); cached_chunk != chunks_.end())
            return cached_chunk->second;
    }
    const SharedBytes chunk = unpack();
    const std::lock_guard guard(lock_);
    if (find_cached_chunk() == chunks_.end()) chunks_.emplace_back(chunk_offset, chunk);
    if (chunks_.size() > kMaxCachedChunks) chunks_.pop_front();
    return chunk;
}

SharedBytes unpack_chunk(std::string_view compression, const SharedBytes& compressed_chunk,
                         std::uint64_t unpacked_size) {
    const std::string_view bytes = compressed_chunk.bytes;
    if (compression.empty() || compression == "none") {
        if (unpacked_size != bytes.size())
            fail("found {} bytes of uncompressed data, expected {}", bytes.size(), unpacked_size);
        return compressed_chunk;
    }
    ChunkUnpacker unpack = nullptr;
    if (compression == "lz4") unpack = decompress_lz4;
    else if (compression == "zstd") unpack = decompress_zstd;
    else if (compression == "bz2") unpack = unpack_bz2;
    else
        fail("found the compression '{}', expected none, lz4, zstd or bz2",
             shorten_for_error_message(compression));
    if (unpacked_size > UINT_MAX ||
        (unpacked_size > kAlwaysUnpacked && unpacked_size / kMostUnpacked > bytes.size()))
        fail("found {} compressed bytes that unpack to {} bytes, expected at most {} unpacked bytes",
             bytes.size(), unpacked_size,
             std::min(std::uint64_t(UINT_MAX), std::max(kAlwaysUnpacked, kMostUnpacked * bytes.size())));
    return allocate_shared_bytes(std::size_t(unpacked_size), [&](std::span<char> target) {
        if (unpacked_size > 0 || !bytes.empty()) unpack(bytes, target);
    });
}

}  // namespace relidar::bag
