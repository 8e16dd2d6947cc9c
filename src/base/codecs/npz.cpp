// SPDX-License-Identifier: Apache-2.0
// Writes npz files like numpy.savez_compressed, and reads those of numpy.savez, too. All
// entries have the same time (1980-01-01), so that equal arrays give identical files.
// libzip checks the directory, the headers and the checksum of each entry, and adds zip64
// fields to files above 4 GiB.
#include <relidar/base/arrays.hpp>
#include <relidar/base/files.hpp>

#include <array>
#include <list>
#include <memory>
#include <mutex>
#include <set>

#include <zip.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "file_io.hpp"
#include "named_array.hpp"
#include "npy.hpp"

namespace relidar {
namespace {

constexpr zip_uint16_t kFirstDosDate = 0x0021;  // 1980-01-01, the earliest date of the format.
constexpr zip_uint32_t kDeflateLevel = 6;

void check_arrays(const std::vector<NamedArray>& arrays) {
    if (arrays.empty()) fail("found no array, expected at least one");
    std::set<std::string> names;
    for (const NamedArray& array : arrays) {
        codecs::check_array(array);
        if (!names.insert(array.name).second) fail("array name '{}' is used twice", array.name);
    }
}

/// Opens an archive. The first call sets static variables of libzip without a lock, so
/// two first calls at the same time could see an archive that is read-only.
zip_t* open_archive(zip_source_t* source, int flags, zip_error_t* error) {
    static std::mutex first_call;
    const std::lock_guard guard(first_call);
    return zip_open_from_source(source, flags, error);
}

/// Adds an array to an archive as an entry NAME.npy. libzip copies the list `parts`, but
/// reads the header and the values only when the archive closes.
/// @param header of the .npy file
void add_array(zip_t* archive, const NamedArray& array, std::string& header) {
    const std::array<zip_buffer_fragment_t, 2> parts{
        {{reinterpret_cast<zip_uint8_t*>(header.data()), header.size()},
         {reinterpret_cast<zip_uint8_t*>(const_cast<std::byte*>(array.bytes.data())), array.bytes.size()}}};
    zip_source_t* source = zip_source_buffer_fragment_create(parts.data(), parts.size(), 0, nullptr);
    const zip_int64_t index = zip_file_add(archive, (array.name + ".npy").c_str(), source, ZIP_FL_ENC_UTF_8);
    if (index < 0) {
        zip_source_free(source);
        fail("array '{}': {}", array.name, zip_strerror(archive));
    }
    zip_set_file_compression(archive, std::uint64_t(index), ZIP_CM_DEFLATE, kDeflateLevel);
    zip_file_set_dostime(archive, std::uint64_t(index), 0, kFirstDosDate, 0);
}

/// Returns an open archive of the arrays. It is in memory, because libzip would put its
/// own temporary files next to a file. The caller frees it.
zip_source_t* make_zip(const std::vector<NamedArray>& arrays) {
    zip_source_t* target = zip_source_buffer_create(nullptr, 0, 0, nullptr);
    zip_source_keep(target);  // Otherwise zip_close() would free it.
    zip_t* archive = open_archive(target, ZIP_TRUNCATE, nullptr);
    if (!archive) fail("libzip cannot make an archive");
    std::list<std::string> headers;  // A list does not move its elements.
    try {
        for (const NamedArray& array : arrays)
            add_array(archive, array, headers.emplace_back(codecs::make_npy_header(array)));
        if (zip_close(archive) != 0) fail("{}", zip_strerror(archive));
    } catch (...) {
        zip_discard(archive);
        zip_source_free(target);
        throw;
    }
    return target;
}

// Maximum compression ratio of deflate. An entry with a higher ratio is invalid.
constexpr std::size_t kMaxExpansion = 1032;

using ZipArchive = std::unique_ptr<zip_t, decltype(&zip_discard)>;

/// Opens an archive in memory. `bytes` must exist as long as the archive.
ZipArchive open_zip(std::string_view bytes) {
    if (bytes.empty()) fail("the file is empty");  // libzip would see an archive without entries.
    zip_error_t error;
    zip_error_init(&error);
    constexpr int kKeepBytes = 0;  // libzip does not free the bytes.
    zip_source_t* source = zip_source_buffer_create(bytes.data(), bytes.size(), kKeepBytes, &error);
    // ZIP_CHECKCONS compares the directory with the headers of the entries.
    zip_t* archive = open_archive(source, ZIP_RDONLY | ZIP_CHECKCONS, &error);
    if (!archive) {
        const std::string reason = zip_error_strerror(&error);
        zip_source_free(source);
        fail("{}; expected a complete zip archive", reason);
    }
    return {archive, zip_discard};
}

/// Decompresses and parses an entry NAME.npy. Before it allocates memory, it checks that
/// the compressed size allows the stated size.
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
    std::string bytes(entry.size, '\0');
    const zip_int64_t n_read = zip_fread(file.get(), bytes.data(), bytes.size());
    // libzip compares the checksum when it finds the end of the data.
    char more;
    if (n_read != zip_int64_t(bytes.size()) || zip_fread(file.get(), &more, 1) != 0)
        fail("found {} of {} bytes: {}", n_read, bytes.size(), zip_file_strerror(file.get()));
    name.resize(name.size() - kNpySuffix.size());
    return codecs::parse_npy(name, bytes);
}

/// Reads all arrays of an npz file, which is a zip archive of .npy files.
std::vector<NamedArray> parse_npz(std::string_view bytes) {
    const ZipArchive archive = open_zip(bytes);
    std::vector<NamedArray> arrays;
    std::uint64_t n_packed_bytes = 0;  // of the entries so far
    for (zip_int64_t i = 0; i < zip_get_num_entries(archive.get(), 0); ++i) {
        zip_stat_t entry;
        if (zip_stat_index(archive.get(), std::uint64_t(i), 0, &entry) != 0)
            fail("{}", zip_strerror(archive.get()));
        // Entries that overlap could unpack the same bytes many times (zip bomb).
        if (entry.comp_size > bytes.size() - n_packed_bytes) fail("the zip entries overlap");
        n_packed_bytes += entry.comp_size;
        try {
            arrays.push_back(read_zip_entry(archive.get(), entry));
        } catch (const DataError& error) {
            fail("entry '{}': {}", entry.name, error.what());
        }
    }
    return arrays;
}

}  // namespace

void write_npz(const std::filesystem::path& path, const std::vector<NamedArray>& arrays) {
    write_atomically(path, [&](const std::filesystem::path& temporary) {
        check_arrays(arrays);
        const std::unique_ptr<zip_source_t, decltype(&zip_source_free)> zip(make_zip(arrays),
                                                                            zip_source_free);
        codecs::OutputFile file(temporary);
        const auto check = [&](zip_int64_t result) {  // negative: an error
            if (result < 0) fail("{}", zip_error_strerror(zip_source_error(zip.get())));
            return std::size_t(result);
        };
        check(zip_source_open(zip.get()));
        std::array<char, 1 << 16> piece;
        while (const std::size_t n_read = check(zip_source_read(zip.get(), piece.data(), piece.size())))
            file.write(piece.data(), n_read);
        file.close();
    });
}

std::vector<NamedArray> read_npz(const std::filesystem::path& path) {
    const std::string bytes = read_file(path);
    try {
        return parse_npz(bytes);
    } catch (const DataError& error) {
        fail("cannot read npz '{}': {}", path.string(), error.what());
    }
}

NamedArray read_npy(const std::filesystem::path& path) {
    const std::string bytes = read_file(path);
    try {
        return codecs::parse_npy(path.stem().string(), bytes);
    } catch (const DataError& error) {
        fail("cannot read npy '{}': {}", path.string(), error.what());
    }
}

}  // namespace relidar
