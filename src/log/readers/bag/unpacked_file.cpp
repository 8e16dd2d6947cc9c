// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/unpacked_file.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string_view>
#include <system_error>
#include <vector>

#include <unistd.h>
#include <zlib.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/codecs/unpack.hpp"
#include "base/fail.hpp"

namespace relidar::bag {
namespace {

struct CloseFile {
    void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

/// Creates an empty file without a name, for reading and writing.
File open_temporary_file() {
    std::error_code failed;
    std::string name = (std::filesystem::temp_directory_path(failed) / "relidar-XXXXXX").string();
    const int descriptor = failed ? -1 : mkstemp(name.data());
    File file(descriptor < 0 ? nullptr : fdopen(descriptor, "w+b"));
    if (!file) throw DataError("cannot create a temporary file to unpack a recording");
    unlink(name.c_str());
    return file;
}

/// Writes bytes of an unpacked file. Flushes the file if there are no bytes.
void write_block_or_flush(const File& unpacked, std::string_view bytes, const std::filesystem::path& packed) {
    if (std::fwrite(bytes.data(), 1, bytes.size(), unpacked.get()) != bytes.size() ||
        (bytes.empty() && std::fflush(unpacked.get()) != 0))
        fail("cannot unpack {}: no space is left in {}", packed.string(),
             std::filesystem::temp_directory_path().string());
}

/// Throws if an unpacked file is much larger than the file, because the file is then
/// damaged.
void check_unpacked_size(const std::filesystem::path& packed, std::uint64_t n_unpacked) {
    constexpr std::uint64_t kMostGrowth = 100, kSmall = std::uint64_t(64) << 20;
    if (n_unpacked > kSmall && n_unpacked / kMostGrowth > std::filesystem::file_size(packed))
        fail("cannot unpack {}: found more than {} bytes, expected at most {} times the size of the file",
             packed.string(), n_unpacked, kMostGrowth);
}

}  // namespace

std::filesystem::path remove_zstd_extension(const std::filesystem::path& file) {
    return file.extension() == ".zstd" || file.extension() == ".zst"
               ? std::filesystem::path(file).replace_extension()
               : file;
}

UnpackedZstdFile::UnpackedZstdFile(const std::filesystem::path& file) : path_(file) {
    const File packed(std::fopen(file.c_str(), "rb"));
    std::vector<char> block(1 << 20);
    const auto read_block = [&] {
        return std::string_view(block.data(), std::fread(block.data(), 1, block.size(), packed.get()));
    };
    // The callers report a file that cannot be read.
    if (!packed || !read_block().starts_with(kZstdMagic)) return;
    std::rewind(packed.get());
    std::string folder = (std::filesystem::temp_directory_path() / "relidar-XXXXXX").string();
    if (!mkdtemp(folder.data())) throw DataError("cannot create a temporary folder to unpack a recording");
    temporary_folder_ = folder;
    path_ = temporary_folder_ / remove_zstd_extension(file).filename();
    try {
        const File unpacked(std::fopen(path_.c_str(), "wb"));
        if (!unpacked) fail("cannot write {}", path_.string());
        std::uint64_t n_unpacked = 0;
        is_truncated_ = !stream_zstd(read_block, [&](std::string_view bytes) {
            check_unpacked_size(file, n_unpacked += bytes.size());
            write_block_or_flush(unpacked, bytes, file);
        });
        write_block_or_flush(unpacked, {}, file);
    } catch (const DataError& error) {
        std::error_code ignored;
        std::filesystem::remove_all(temporary_folder_, ignored);
        fail("{}: {}", file.string(), error.what());
    }
}

UnpackedZstdFile::~UnpackedZstdFile() {
    std::error_code ignored;
    if (!temporary_folder_.empty()) std::filesystem::remove_all(temporary_folder_, ignored);
}

std::filesystem::path remove_gz_extension(const std::filesystem::path& file) {
    return file.extension() == ".gz" ? std::filesystem::path(file).replace_extension() : file;
}

DecompressedFile open_file_and_unpack_gzip(const std::filesystem::path& path) {
    File packed(std::fopen(path.c_str(), "rb"));
    if (!packed) fail("cannot read {}", path.string());
    const int first = std::fgetc(packed.get()), second = std::fgetc(packed.get());
    std::rewind(packed.get());
    if (first != 0x1f || second != 0x8b) return {packed.release(), ""};
    const std::unique_ptr<gzFile_s, int (*)(gzFile)> reader(gzopen(path.c_str(), "rb"), gzclose);
    if (!reader) fail("cannot read {}", path.string());
    File unpacked = open_temporary_file();
    const auto write = [&](const char* bytes, std::size_t n_bytes) {
        write_block_or_flush(unpacked, {bytes, n_bytes}, path);
    };
    std::uint64_t n_unpacked = 0;
    std::vector<char> block(1 << 20);
    int n = 0;
    while ((n = gzread(reader.get(), block.data(), unsigned(block.size()))) > 0) {
        check_unpacked_size(path, n_unpacked += std::uint64_t(n));
        write(block.data(), std::size_t(n));
    }
    write(nullptr, 0);
    int code = Z_OK;
    gzerror(reader.get(), &code);
    const bool is_cut = n < 0 || (code != Z_OK && code != Z_STREAM_END);
    std::rewind(unpacked.get());
    return {unpacked.release(), is_cut ? "the gzip file is damaged or truncated" : ""};
}

}  // namespace relidar::bag
