// SPDX-License-Identifier: Apache-2.0
#include "read/bag/part_file.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <climits>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <system_error>
#include <vector>

#include <bzlib.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include "base/codecs/unpack.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar::bag {
namespace {

/// A chunk that unpacks to more than kMaxChunkGrowth times its size is damaged, unless it
/// is small. Point clouds usually unpack to three times their size.
constexpr std::uint64_t kMaxChunkGrowth = 8, kSmallChunkBytes = std::uint64_t(8) << 20;
constexpr std::string_view kGzipMagic("\x1f\x8b", 2);  // first bytes of a gzip file

/// Unpacks bz2 data to exactly `target.size()` bytes.
void unpack_bz2(std::string_view source, std::span<char> target) {
    int code = BZ_PARAM_ERROR;
    unsigned n_unpacked = unsigned(target.size());
    constexpr int kFastMode = 0, kSilent = 0;
    if (source.size() <= UINT_MAX)
        code = BZ2_bzBuffToBuffDecompress(target.data(), &n_unpacked, const_cast<char*>(source.data()),
                                          unsigned(source.size()), kFastMode, kSilent);
    if (code != BZ_OK || n_unpacked != target.size())
        fail("the bz2 data is damaged, expected {} bytes after unpacking", target.size());
}

using ChunkUnpacker = void (*)(std::string_view, std::span<char>);

std::string last_error() { return std::error_code(errno, std::generic_category()).message(); }

struct CloseFile {
    void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

/// Decompresses a gzip file, like stream_zstd().
/// @return false if the file is damaged or truncated
bool unpack_gzip(const std::filesystem::path& file,
                 const std::function<void(std::string_view)>& write_block) {
    const std::unique_ptr<gzFile_s, int (*)(gzFile)> reader(gzopen(file.c_str(), "rb"), gzclose);
    if (!reader) fail("the file cannot be read");
    std::vector<char> block(1 << 20);
    int n = 0, code = Z_OK;
    while ((n = gzread(reader.get(), block.data(), unsigned(block.size()))) > 0)
        write_block({block.data(), std::size_t(n)});
    gzerror(reader.get(), &code);
    return n == 0 && (code == Z_OK || code == Z_STREAM_END);
}

bool unpack_zstd(std::FILE* file, const std::function<void(std::string_view)>& write_block) {
    std::vector<char> block(1 << 20);
    return stream_zstd(
        [&] { return std::string_view(block.data(), std::fread(block.data(), 1, block.size(), file)); },
        write_block);
}

}  // namespace

RandomAccessFile::RandomAccessFile(const std::filesystem::path& path) : name_(path.string()) {
    handle_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (handle_ < 0) fail("{}: the file cannot be opened: {}", name_, last_error());
    struct stat status {};
    if (::fstat(handle_, &status) != 0 || !S_ISREG(status.st_mode)) {
        ::close(handle_);
        fail("{}: this path is not a regular file", name_);
    }
    size_ = std::uint64_t(status.st_size);
}

SharedBytes RandomAccessFile::read_bytes_at(std::uint64_t offset, std::uint64_t n_bytes) const {
    if (offset > size_ || n_bytes > size_ - offset)
        fail("the file is truncated: it has {} bytes after byte {}, expected {} bytes",
             size_ - std::min(offset, size_), offset, n_bytes);
    return allocate_bytes(std::size_t(n_bytes), [&](std::span<char> bytes) {
        std::size_t n_read = 0;  // pread() may read only a part
        while (n_read < bytes.size()) {
            const ssize_t n =
                ::pread(handle_, bytes.data() + n_read, bytes.size() - n_read, off_t(offset + n_read));
            if (n < 0 && errno == EINTR) continue;  // a signal interrupted the call
            if (n <= 0)
                fail("cannot read {} bytes that start at byte {}: {}", n_bytes, offset,
                     n < 0 ? last_error() : "the file has become shorter since it was opened");
            n_read += std::size_t(n);
        }
    });
}

SharedBytes ChunkCache::find_or_unpack(std::uint64_t chunk_offset,
                                       const std::function<SharedBytes()>& unpack) const {
    const auto find_cached = [&] {
        return std::ranges::find_if(chunks_,
                                    [&](const auto& cached) { return cached.first == chunk_offset; });
    };
    {
        const std::lock_guard guard(lock_);
        const auto cached = find_cached();
        if (cached != chunks_.end()) return cached->second;
    }
    // Unpacks without the lock, so that other threads are not blocked.
    const SharedBytes chunk = unpack();
    const std::lock_guard guard(lock_);
    // Another thread may have added the same chunk.
    if (find_cached() == chunks_.end()) chunks_.emplace_back(chunk_offset, chunk);
    if (chunks_.size() > kMaxCachedChunks) chunks_.pop_front();
    return chunk;
}

SharedBytes unpack_chunk(std::string_view compression, const SharedBytes& chunk, std::uint64_t size) {
    const std::string_view bytes = chunk.bytes;
    if (compression.empty() || compression == "none") {
        if (size != bytes.size())
            fail("found {} bytes of uncompressed data, expected {}", bytes.size(), size);
        return chunk;
    }
    ChunkUnpacker unpack = nullptr;
    if (compression == "lz4") unpack = decompress_lz4;
    else if (compression == "zstd") unpack = decompress_zstd;
    else if (compression == "bz2") unpack = unpack_bz2;
    else fail("found the compression '{}', expected none, lz4, zstd or bz2", quote(compression));
    const bool grows_too_much = size > kSmallChunkBytes && size / kMaxChunkGrowth > bytes.size();
    if (size > UINT_MAX || grows_too_much)
        fail("found {} compressed bytes that unpack to {} bytes, expected at most {} unpacked bytes",
             bytes.size(), size,
             std::min(std::uint64_t(UINT_MAX), std::max(kSmallChunkBytes, kMaxChunkGrowth * bytes.size())));
    return allocate_bytes(std::size_t(size), [&](std::span<char> target) {
        if (size > 0 || !bytes.empty()) unpack(bytes, target);
    });
}

UnpackedFile::UnpackedFile(const std::filesystem::path& file) : path_(file) {
    const File packed(std::fopen(file.c_str(), "rb"));
    if (!packed) return;  // The callers report a file that cannot be read.
    std::array<char, kZstdMagic.size()> first{};
    const std::string_view begin(first.data(), std::fread(first.data(), 1, first.size(), packed.get()));
    const bool is_gzip = begin.starts_with(kGzipMagic);
    if (!is_gzip && !begin.starts_with(kZstdMagic)) return;
    std::rewind(packed.get());
    std::string folder = (std::filesystem::temp_directory_path() / "relidar-XXXXXX").string();
    if (!mkdtemp(folder.data())) fail("cannot create a temporary folder to unpack a recording");
    temporary_folder_ = folder;
    path_ = temporary_folder_ / strip_packed(file).filename();
    try {
        const File unpacked(std::fopen(path_.c_str(), "wb"));
        if (!unpacked) fail("cannot write {}", path_.string());
        const auto require_space = [&](bool has_space) {
            if (!has_space)
                fail("no space is left in {} for the unpacked file",
                     std::filesystem::temp_directory_path().string());
        };
        const std::uint64_t n_packed = std::filesystem::file_size(file);
        std::uint64_t n_unpacked = 0;
        const auto write_block = [&](std::string_view bytes) {
            // A file that grows more is damaged.
            constexpr std::uint64_t kMostGrowth = 100, kSmall = std::uint64_t(64) << 20;
            n_unpacked += bytes.size();
            if (n_unpacked > kSmall && n_unpacked / kMostGrowth > n_packed)
                fail("found more than {} unpacked bytes, expected at most {} times the size of the file",
                     n_unpacked, kMostGrowth);
            require_space(std::fwrite(bytes.data(), 1, bytes.size(), unpacked.get()) == bytes.size());
        };
        const bool is_complete =
            is_gzip ? unpack_gzip(file, write_block) : unpack_zstd(packed.get(), write_block);
        is_truncated_ = !is_complete;
        require_space(std::fflush(unpacked.get()) == 0);
    } catch (const DataError& error) {
        // A constructor that throws has no destructor call, so it cleans up here.
        std::error_code ignored;
        std::filesystem::remove_all(temporary_folder_, ignored);
        fail("{}: {}", file.string(), error.what());
    }
}

UnpackedFile::~UnpackedFile() {
    std::error_code ignored;
    if (!temporary_folder_.empty()) std::filesystem::remove_all(temporary_folder_, ignored);
}

RandomAccessFile::~RandomAccessFile() { ::close(handle_); }

}  // namespace relidar::bag
