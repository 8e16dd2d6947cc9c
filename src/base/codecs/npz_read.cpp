// SPDX-License-Identifier: Apache-2.0
// Reads npz files from numpy.savez and numpy.savez_compressed. libzip checks the
// directory, the headers and the checksum of each entry.

#include <memory>

#include <zip.h>

#include "base/fail.hpp"
#include "file_io.hpp"
#include "npy.hpp"

namespace relidar {
namespace {

// Maximum compression ratio of deflate. An entry with a higher ratio is invalid.
constexpr std::size_t kMaxExpansion = 1032;

using ZipArchive = std::unique_ptr<zip_t, decltype(&zip_discard)>;

ZipArchive open_zip(const std::vector<std::byte>& bytes) {
    if (bytes.empty()) fail("the file is empty");  // libzip would see an archive without entries.
    zip_error_t error;
    zip_error_init(&error);
    // 0: libzip does not free the bytes. ZIP_CHECKCONS also checks the entries.
    zip_source_t* source = zip_source_buffer_create(bytes.data(), bytes.size(), 0, &error);
    zip_t* archive = zip_open_from_source(source, ZIP_RDONLY | ZIP_CHECKCONS, &error);
    if (!archive) {
        const std::string reason = zip_error_strerror(&error);
        zip_source_free(source);
        fail("{}; expected a complete zip archive", reason);
    }
    return {archive, zip_discard};
}

NamedArray read_zip_entry(zip_t* archive, const zip_stat_t& entry) {
    constexpr std::string_view kNpySuffix = ".npy";
    std::string name = entry.name;
    if (name.size() <= kNpySuffix.size() || !name.ends_with(kNpySuffix))
        fail("the name of the entry does not end in .npy, expected an array of NumPy");
    if (entry.size / kMaxExpansion > entry.comp_size)
        fail("{} bytes of compressed data cannot unpack to {} bytes", entry.comp_size, entry.size);
    const std::unique_ptr<zip_file_t, decltype(&zip_fclose)> file(
        zip_fopen_index(archive, entry.index, ZIP_FL_UNCHANGED), zip_fclose);
    if (!file) fail("{}", zip_strerror(archive));
    std::vector<std::byte> bytes(entry.size);
    const zip_int64_t n_read = zip_fread(file.get(), bytes.data(), bytes.size());
    // libzip compares the checksum when it finds the end of the data.
    std::byte more;
    if (n_read != zip_int64_t(bytes.size()) || zip_fread(file.get(), &more, 1) != 0)
        fail("found {} of {} bytes: {}", n_read, bytes.size(), zip_file_strerror(file.get()));
    name.resize(name.size() - kNpySuffix.size());
    return codecs::parse_npy(name, bytes);
}

std::vector<NamedArray> parse_npz(const std::vector<std::byte>& bytes) {
    const ZipArchive archive = open_zip(bytes);
    std::vector<NamedArray> arrays;
    std::uint64_t n_packed = 0;
    for (zip_int64_t i = 0; i < zip_get_num_entries(archive.get(), 0); ++i) {
        zip_stat_t entry;
        if (zip_stat_index(archive.get(), std::uint64_t(i), 0, &entry) != 0)
            fail("{}", zip_strerror(archive.get()));
        // Rejects overlapping entries, which zip bombs use.
        if (entry.comp_size > bytes.size() - n_packed) fail("the zip entries overlap");
        n_packed += entry.comp_size;
        try {
            arrays.push_back(read_zip_entry(archive.get(), entry));
        } catch (const DataError& error) {
            fail("entry '{}': {}", entry.name, error.what());
        }
    }
    return arrays;
}

}  // namespace

std::vector<NamedArray> read_npz(const std::filesystem::path& path) {
    const std::vector<std::byte> bytes = codecs::read_file(path);
    try {
        return parse_npz(bytes);
    } catch (const DataError& error) {
        fail("cannot read npz '{}': {}", path.string(), error.what());
    }
}

NamedArray read_npy(const std::filesystem::path& path) {
    const std::vector<std::byte> bytes = codecs::read_file(path);
    try {
        return codecs::parse_npy(path.stem().string(), bytes);
    } catch (const DataError& error) {
        fail("cannot read npy '{}': {}", path.string(), error.what());
    }
}

}  // namespace relidar
