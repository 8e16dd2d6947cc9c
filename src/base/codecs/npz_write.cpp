// SPDX-License-Identifier: Apache-2.0
// Writes npz files, which are zip archives of deflated .npy files, like
// numpy.savez_compressed. All entries have the same time (1980-01-01), so that equal
// arrays give identical files. Rejects entries and archives of 4 GiB or more, because
// zip64 is not supported.
#include <relidar/base/arrays.hpp>
#include <relidar/base/files.hpp>

#include <limits>
#include <set>

#include <fmt/format.h>
#include <zlib.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "file_io.hpp"
#include "named_array.hpp"
#include "npy.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kLocalHeader = 0x04034b50, kCentralHeader = 0x02014b50, kEndRecord = 0x06054b50;
constexpr std::uint16_t kVersion = 20;  // Zip version that a reader needs for deflate.
constexpr std::uint16_t kUtf8Names = 1 << 11;
constexpr std::uint16_t kDeflated = 8;
constexpr std::uint16_t kDate = 0x0021;  // 1980-01-01, the earliest date of the format.
// In a 32-bit field of a zip file, this value means "see the zip64 field". Therefore all
// sizes and offsets must be smaller.
constexpr std::uint64_t kLimit = std::numeric_limits<std::uint32_t>::max();

/// A file in the zip archive. Its local header and the central directory both contain
/// these values.
struct ZipEntry {
    std::string name;
    std::uint32_t crc = 0, packed_size = 0, size = 0, offset = 0;
};

/// Compresses data piece by piece with raw deflate, which has no zlib header. Also
/// computes the checksum of the uncompressed data.
class Deflater {
public:
    Deflater() {
        if (deflateInit2(&stream_, Z_DEFAULT_COMPRESSION, Z_DEFLATED, -MAX_WBITS, 8, Z_DEFAULT_STRATEGY) !=
            Z_OK)
            throw std::bad_alloc();
    }
    ~Deflater() { deflateEnd(&stream_); }
    Deflater(const Deflater&) = delete;
    Deflater& operator=(const Deflater&) = delete;

    /// Compresses one piece of the data.
    /// @param n_bytes below 4 GiB
    /// @param is_last_chunk true for the last piece
    void compress_chunk(const void* data, std::size_t n_bytes, bool is_last_chunk) {
        const auto* bytes = static_cast<const Bytef*>(data);
        // Skips empty pieces, because zlib resets the checksum if the pointer is null.
        if (n_bytes > 0) crc = std::uint32_t(::crc32(crc, bytes, uInt(n_bytes)));
        stream_.next_in = const_cast<Bytef*>(bytes);
        stream_.avail_in = uInt(n_bytes);
        do {
            Bytef chunk[1 << 16];
            stream_.next_out = chunk;
            stream_.avail_out = sizeof chunk;
            ::deflate(&stream_, is_last_chunk ? Z_FINISH : Z_NO_FLUSH);
            packed.append(reinterpret_cast<const char*>(chunk), sizeof chunk - stream_.avail_out);
        } while (stream_.avail_out == 0);
    }

    std::string packed;
    std::uint32_t crc = 0;

private:
    z_stream stream_{};
};

/// Appends the fields from "version needed" to "name length", which are the same in the
/// local header and the central directory.
void append_common_header_fields(std::string& bytes, const ZipEntry& entry) {
    append_binary_value(bytes, kVersion);
    append_binary_value(bytes, kUtf8Names);
    append_binary_value(bytes, kDeflated);
    append_binary_value(bytes, std::uint16_t(0));  // Zip field: modification time.
    append_binary_value(bytes, kDate);
    append_binary_value(bytes, entry.crc);
    append_binary_value(bytes, entry.packed_size);
    append_binary_value(bytes, entry.size);
    append_binary_value(bytes, std::uint16_t(entry.name.size()));
    append_binary_value(bytes, std::uint16_t(0));  // Zip field: length of the extra field.
}

std::string make_zip_local_header(const ZipEntry& entry) {
    std::string bytes;
    append_binary_value(bytes, kLocalHeader);
    append_common_header_fields(bytes, entry);
    return bytes + entry.name;
}

std::string make_zip_central_header(const ZipEntry& entry) {
    std::string bytes;
    append_binary_value(bytes, kCentralHeader);
    append_binary_value(bytes, kVersion);  // Zip field: version of the writer.
    append_common_header_fields(bytes, entry);
    append_binary_value(bytes, std::uint16_t(0));  // Zip field: length of the comment.
    append_binary_value(bytes, std::uint16_t(0));  // Zip field: disk number.
    append_binary_value(bytes, std::uint16_t(0));  // Zip field: internal file attributes.
    append_binary_value(bytes, std::uint32_t(0));  // Zip field: external file attributes.
    append_binary_value(bytes, entry.offset);
    return bytes + entry.name;
}

std::string make_zip_end_record(std::size_t n_entries, std::size_t directory_size_bytes,
                                std::size_t directory_offset) {
    std::string bytes;
    append_binary_value(bytes, kEndRecord);
    append_binary_value(bytes, std::uint32_t(0));  // Zip fields: disk numbers.
    append_binary_value(bytes, std::uint16_t(n_entries));
    append_binary_value(bytes, std::uint16_t(n_entries));
    append_binary_value(bytes, std::uint32_t(directory_size_bytes));
    append_binary_value(bytes, std::uint32_t(directory_offset));
    append_binary_value(bytes, std::uint16_t(0));  // Zip field: length of the comment.
    return bytes;
}

void require_size_within_npz_limit(const std::string& description, std::uint64_t n_bytes) {
    if (n_bytes >= kLimit)
        fail("{} has {} bytes, but npz files have at most 4 GiB; use safetensors", description, n_bytes);
}

/// Writes an array to the zip file at `file_offset`.
/// @return directory entry of the array
ZipEntry write_array_as_zip_entry(report_detail::OutputFile& file, const NamedArray& array,
                                  std::size_t file_offset) {
    const std::string header = report_detail::make_npy_header(array);
    require_size_within_npz_limit(fmt::format("array '{}'", array.name), header.size() + array.bytes.size());
    Deflater deflater;
    deflater.compress_chunk(header.data(), header.size(), false);
    deflater.compress_chunk(array.bytes.data(), array.bytes.size(), true);
    require_size_within_npz_limit("the archive",
                                  file_offset + deflater.packed.size() + array.name.size() + 1024);
    const ZipEntry entry{array.name + ".npy", deflater.crc, std::uint32_t(deflater.packed.size()),
                         std::uint32_t(header.size() + array.bytes.size()), std::uint32_t(file_offset)};
    file.write(make_zip_local_header(entry));
    file.write(deflater.packed);
    return entry;
}

void require_arrays_valid_for_npz(const std::vector<NamedArray>& arrays) {
    std::set<std::string> names;
    for (const NamedArray& array : arrays) {
        report_detail::require_valid_array_type_and_size(array);
        if (array.name.size() > 0xFF00) throw DataError("an array name is too long");
        if (!names.insert(array.name).second) fail("array name '{}' is used twice", array.name);
    }
    if (arrays.size() >= 0xFFFF) fail("found {} arrays, but npz files contain at most 65534", arrays.size());
}

}  // namespace

void write_npz(const std::filesystem::path& path, const std::vector<NamedArray>& arrays) {
    write_file_atomically(path, [&](const std::filesystem::path& temporary) {
        require_arrays_valid_for_npz(arrays);
        report_detail::OutputFile file(temporary);
        std::size_t offset = 0;
        std::string directory;
        for (const NamedArray& array : arrays) {
            const ZipEntry entry = write_array_as_zip_entry(file, array, offset);
            offset += make_zip_local_header(entry).size() + entry.packed_size;
            directory += make_zip_central_header(entry);
        }
        require_size_within_npz_limit("the archive", offset + directory.size());
        file.write(directory);
        file.write(make_zip_end_record(arrays.size(), directory.size(), offset));
        file.close();
    });
}

}  // namespace relidar
