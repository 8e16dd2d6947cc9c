// SPDX-License-Identifier: Apache-2.0
// Writes npz files, which are zip archives of deflated .npy files, like
// numpy.savez_compressed. All entries have the same time (1980-01-01), so that equal
// arrays give identical files. libzip adds zip64 fields to files above 4 GiB.
#include <relidar/base/files.hpp>

#include <array>
#include <list>
#include <set>

#include <zip.h>

#include "base/fail.hpp"
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

void add_array(zip_t* archive, const NamedArray& array, std::string& header) {
    // libzip reads the header and the values later, without a copy.
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
    // A fixed date, so that equal arrays give equal files.
    zip_file_set_dostime(archive, std::uint64_t(index), 0, kFirstDosDate, 0);
}

/// In memory, because libzip would put its own temporary files next to a file.
zip_source_t* make_zip(const std::vector<NamedArray>& arrays) {
    zip_source_t* target = zip_source_buffer_create(nullptr, 0, 0, nullptr);
    zip_source_keep(target);
    zip_t* archive = zip_open_from_source(target, ZIP_TRUNCATE, nullptr);
    std::list<std::string> headers;
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

}  // namespace

void write_npz(const std::filesystem::path& path, const std::vector<NamedArray>& arrays) {
    write_atomically(path, [&](const std::filesystem::path& temporary) {
        check_arrays(arrays);
        const std::unique_ptr<zip_source_t, decltype(&zip_source_free)> zip(make_zip(arrays),
                                                                            zip_source_free);
        codecs::OutputFile file(temporary);
        std::array<char, 1 << 16> piece;
        zip_int64_t n = zip_source_open(zip.get());
        if (n == 0)
            while ((n = zip_source_read(zip.get(), piece.data(), piece.size())) > 0)
                file.write(piece.data(), std::size_t(n));
        if (n < 0) fail("{}", zip_error_strerror(zip_source_error(zip.get())));
        file.close();
    });
}

}  // namespace relidar
