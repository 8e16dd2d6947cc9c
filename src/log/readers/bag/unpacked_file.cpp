// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/unpacked_file.hpp"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <system_error>
#include <vector>

#include <unistd.h>
#include <zlib.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

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

}  // namespace

std::filesystem::path remove_gz_extension(const std::filesystem::path& file) {
    return file.extension() == ".gz" ? std::filesystem::path(file).replace_extension() : file;
}

DecompressedFile open_file_and_unpack_gzip(const std::filesystem::path& path) {
    File packed(std::fopen(path.c_str(), "rb"));
    if (!packed) throw DataError(fmt::format("cannot read {}", path.string()));
    const int first = std::fgetc(packed.get()), second = std::fgetc(packed.get());
    std::rewind(packed.get());
    if (first != 0x1f || second != 0x8b) return {packed.release(), ""};
    const std::unique_ptr<gzFile_s, int (*)(gzFile)> reader(gzopen(path.c_str(), "rb"), gzclose);
    if (!reader) throw DataError(fmt::format("cannot read {}", path.string()));
    File unpacked = open_temporary_file();
    const auto write = [&](const char* bytes, std::size_t n_bytes) {
        if (std::fwrite(bytes, 1, n_bytes, unpacked.get()) != n_bytes ||
            (n_bytes == 0 && std::fflush(unpacked.get()) != 0))
            throw DataError(fmt::format("cannot unpack {}: no space is left in {}", path.string(),
                                        std::filesystem::temp_directory_path().string()));
    };
    // A file is damaged if it unpacks to more than kMostGrowth times its size. Files that
    // unpack to at most kSmall bytes are always accepted.
    constexpr std::uint64_t kMostGrowth = 100, kSmall = std::uint64_t(64) << 20;
    const std::uint64_t most = std::max(kSmall, kMostGrowth * std::filesystem::file_size(path));
    std::uint64_t n_unpacked = 0;
    std::vector<char> block(1 << 20);
    int n = 0;
    while ((n = gzread(reader.get(), block.data(), unsigned(block.size()))) > 0) {
        n_unpacked += std::uint64_t(n);
        if (n_unpacked > most)
            throw DataError(
                fmt::format("cannot unpack {}: found more than {} bytes, expected at most {} "
                            "times the size of the file",
                            path.string(), most, kMostGrowth));
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
