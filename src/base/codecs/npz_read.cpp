// SPDX-License-Identifier: Apache-2.0
// Reads npz files from numpy.savez and numpy.savez_compressed. Supports stored and
// deflated zip entries and zip64 fields. Reads the central directory of the archive.
// Every offset and size is checked against the file before it is used. The checksum of
// each entry is checked after decompression.
#include <relidar/base/arrays.hpp>

#include <algorithm>
#include <cstring>
#include <optional>
#include <set>
#include <span>

#include <fmt/format.h>
#include <zlib.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "file_io.hpp"
#include "npy.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kLocalSignature = 0x04034b50, kCentralSignature = 0x02014b50,
                        kEndSignature = 0x06054b50;
constexpr std::uint32_t kEnd64Signature = 0x06064b50, kLocator64Signature = 0x07064b50;
constexpr std::size_t kLocalSize = 30, kCentralSize = 46, kEndSize = 22, kEnd64Size = 56, kLocator64Size = 20;
constexpr std::uint16_t kZip64Extra = 1;
constexpr std::uint32_t kSee64 = 0xFFFFFFFF;
// Maximum compression ratio of deflate. An entry with a higher ratio is invalid.
constexpr std::size_t kMaxExpansion = 1032;
// Maximum number of bytes in one call of zlib, which counts bytes with 32 bits.
constexpr std::size_t kPiece = 1 << 30;

/// Bytes of the zip archive. get_byte_range() checks the bounds.
struct ZipArchiveBytes {
    std::vector<std::byte> bytes;

    std::span<const std::byte> get_byte_range(std::uint64_t offset, std::uint64_t n_bytes) const {
        if (offset > bytes.size() || n_bytes > bytes.size() - offset)
            fail("expected {} bytes at byte {}, but the file has only {} bytes", n_bytes, offset,
                 bytes.size());
        return std::span(bytes).subspan(offset, n_bytes);
    }
};

template <class T>
T read_zip_field(std::span<const std::byte> bytes, std::size_t byte_offset) {
    if (byte_offset > bytes.size() || sizeof(T) > bytes.size() - byte_offset)
        throw DataError("a zip record is truncated");
    T value;
    std::memcpy(&value, bytes.data() + byte_offset, sizeof value);
    return value;
}

struct ZipDirectoryLocation {
    std::uint64_t n_entries = 0, size = 0, offset = 0;
};

/// Returns the position of the zip end record. This is the last record whose comment ends
/// exactly at the end of the file.
std::size_t find_zip_end_record_offset(const ZipArchiveBytes& archive) {
    const std::size_t n = archive.bytes.size();
    if (n < kEndSize) fail("the file has {} bytes, which are too few for a zip archive", n);
    for (std::size_t back = kEndSize; back <= std::min<std::size_t>(n, kEndSize + 0xFFFF); ++back) {
        const auto record = archive.get_byte_range(n - back, kEndSize);
        if (read_zip_field<std::uint32_t>(record, 0) == kEndSignature &&
            read_zip_field<std::uint16_t>(record, 20) == back - kEndSize)
            return n - back;
    }
    throw DataError("the file is not a zip archive, or it is truncated");
}

ZipDirectoryLocation locate_zip_directory(const ZipArchiveBytes& archive) {
    const std::size_t end = find_zip_end_record_offset(archive);
    const auto record = archive.get_byte_range(end, kEndSize);
    ZipDirectoryLocation directory{read_zip_field<std::uint16_t>(record, 10),
                                   read_zip_field<std::uint32_t>(record, 12),
                                   read_zip_field<std::uint32_t>(record, 16)};
    const bool see64 =
        directory.n_entries == 0xFFFF || directory.size == kSee64 || directory.offset == kSee64;
    if (see64 && end >= kLocator64Size) {
        const auto locator = archive.get_byte_range(end - kLocator64Size, kLocator64Size);
        if (read_zip_field<std::uint32_t>(locator, 0) == kLocator64Signature) {
            const auto end64 = archive.get_byte_range(read_zip_field<std::uint64_t>(locator, 8), kEnd64Size);
            if (read_zip_field<std::uint32_t>(end64, 0) != kEnd64Signature)
                throw DataError("the zip64 end record is damaged");
            directory = {read_zip_field<std::uint64_t>(end64, 32), read_zip_field<std::uint64_t>(end64, 40),
                         read_zip_field<std::uint64_t>(end64, 48)};
        }
    }
    if (directory.size > end || directory.offset > end - directory.size)
        throw DataError("the zip directory is outside the file, so the file is damaged");
    if (directory.n_entries > directory.size / kCentralSize)
        fail("{} zip entries do not fit into a directory of {} bytes", directory.n_entries, directory.size);
    return directory;
}

struct NpzEntry {
    std::string name;
    std::uint16_t flags = 0, method = 0;
    std::uint32_t crc = 0;
    std::uint64_t packed_size = 0, size = 0, offset = 0;
};

/// Reads 64-bit values from the zip64 extra field. This field contains only the values
/// whose 32-bit value is 0xFFFFFFFF, which means "see zip64".
void read_zip64_sizes_into_entry(NpzEntry& entry, std::span<const std::byte> extra_fields) {
    for (std::size_t at = 0; at + 4 <= extra_fields.size();) {
        const std::size_t size = read_zip_field<std::uint16_t>(extra_fields, at + 2);
        if (read_zip_field<std::uint16_t>(extra_fields, at) == kZip64Extra) {
            std::size_t field = at + 4;
            for (std::uint64_t* value : {&entry.size, &entry.packed_size, &entry.offset}) {
                if (*value != kSee64) continue;
                *value = read_zip_field<std::uint64_t>(
                    extra_fields.first(std::min(extra_fields.size(), at + 4 + size)), field);
                field += 8;
            }
            return;
        }
        at += 4 + size;
    }
}

/// Parses the zip directory entry at position `entry_offset`. Then advances
/// `entry_offset` to the next entry.
NpzEntry parse_next_zip_directory_entry(std::span<const std::byte> directory_bytes,
                                        std::size_t& entry_offset) {
    const auto record = directory_bytes.subspan(entry_offset);
    if (read_zip_field<std::uint32_t>(record, 0) != kCentralSignature || record.size() < kCentralSize)
        throw DataError("the zip directory is damaged");
    NpzEntry entry;
    entry.flags = read_zip_field<std::uint16_t>(record, 8);
    entry.method = read_zip_field<std::uint16_t>(record, 10);
    entry.crc = read_zip_field<std::uint32_t>(record, 16);
    entry.packed_size = read_zip_field<std::uint32_t>(record, 20);
    entry.size = read_zip_field<std::uint32_t>(record, 24);
    entry.offset = read_zip_field<std::uint32_t>(record, 42);
    const std::size_t n_name = read_zip_field<std::uint16_t>(record, 28),
                      n_extra = read_zip_field<std::uint16_t>(record, 30);
    const std::size_t n_comment = read_zip_field<std::uint16_t>(record, 32);
    if (n_name + n_extra + n_comment > record.size() - kCentralSize)
        throw DataError("the zip directory is truncated");
    entry.name.assign(reinterpret_cast<const char*>(record.data()) + kCentralSize, n_name);
    read_zip64_sizes_into_entry(entry, record.subspan(kCentralSize + n_name, n_extra));
    entry_offset += kCentralSize + n_name + n_extra + n_comment;
    return entry;
}

std::vector<std::byte> inflate_bytes(std::span<const std::byte> compressed_bytes,
                                     std::size_t uncompressed_size) {
    std::vector<std::byte> result(uncompressed_size);
    z_stream stream{};
    if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) throw std::bad_alloc();
    int status = Z_OK;
    std::size_t consumed = 0, produced = 0;
    // zlib requires a valid output pointer, even if the output is empty.
    Bytef none = 0;
    while (status == Z_OK) {
        stream.next_in = reinterpret_cast<Bytef*>(const_cast<std::byte*>(compressed_bytes.data() + consumed));
        stream.avail_in = uInt(std::min(compressed_bytes.size() - consumed, kPiece));
        stream.next_out = uncompressed_size > 0 ? reinterpret_cast<Bytef*>(result.data() + produced) : &none;
        stream.avail_out = uInt(std::min(uncompressed_size - produced, kPiece));
        const uInt n_in = stream.avail_in, n_out = stream.avail_out;
        status = ::inflate(&stream, Z_NO_FLUSH);
        consumed += n_in - stream.avail_in;
        produced += n_out - stream.avail_out;
    }
    inflateEnd(&stream);
    if (status != Z_STREAM_END || produced != uncompressed_size)
        fail("the compressed data unpack to {} bytes, expected {}", produced, uncompressed_size);
    return result;
}

std::vector<std::byte> decompress_zip_entry(const ZipArchiveBytes& archive, const NpzEntry& entry) {
    if (entry.flags & 1) throw DataError("the entry is encrypted, expected an entry without encryption");
    const auto local = archive.get_byte_range(entry.offset, kLocalSize);
    if (read_zip_field<std::uint32_t>(local, 0) != kLocalSignature)
        throw DataError("the header of the zip entry is damaged");
    const std::uint64_t start = entry.offset + kLocalSize + read_zip_field<std::uint16_t>(local, 26) +
                                read_zip_field<std::uint16_t>(local, 28);
    const auto packed = archive.get_byte_range(start, entry.packed_size);
    std::vector<std::byte> bytes;
    if (entry.method == 0) {
        if (entry.size != entry.packed_size)
            fail(
                "the entry is stored without compression, but has {} bytes in the file and {} bytes when "
                "unpacked, expected equal sizes; the file is damaged",
                entry.packed_size, entry.size);
        bytes.assign(packed.begin(), packed.end());
    } else if (entry.method == 8) {
        if (entry.size / kMaxExpansion > packed.size())
            fail(
                "the file says that {} bytes of compressed data unpack to {} bytes, which is impossible, so "
                "the file is damaged",
                packed.size(), entry.size);
        bytes = inflate_bytes(packed, entry.size);
    } else {
        fail("the entry uses the compression method {}, expected 0 (stored) or 8 (deflated)", entry.method);
    }
    const auto crc = ::crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size());
    if (crc != entry.crc) throw DataError("the checksum of the data is wrong, so the file is damaged");
    return bytes;
}

NamedArray read_array_from_zip_entry(const ZipArchiveBytes& archive, const NpzEntry& entry) {
    constexpr std::string_view kSuffix = ".npy";
    try {
        if (entry.name.size() <= kSuffix.size() || !entry.name.ends_with(kSuffix))
            throw DataError("the name of the entry does not end in .npy, expected an array of NumPy");
        return report_detail::parse_npy(entry.name.substr(0, entry.name.size() - kSuffix.size()),
                                        decompress_zip_entry(archive, entry));
    } catch (const DataError& error) {
        fail("entry '{}': {}", entry.name, error.what());
    }
}

std::vector<NamedArray> parse_npz_arrays(const ZipArchiveBytes& archive) {
    const ZipDirectoryLocation directory = locate_zip_directory(archive);
    const auto records = archive.get_byte_range(directory.offset, directory.size);
    std::vector<NamedArray> arrays;
    std::set<std::string> names;
    std::uint64_t n_packed = 0;
    std::size_t at = 0;
    for (std::uint64_t i = 0; i < directory.n_entries; ++i) {
        const NpzEntry entry = parse_next_zip_directory_entry(records, at);
        if (!names.insert(entry.name).second) fail("entry '{}' occurs twice, expected it once", entry.name);
        n_packed += std::min<std::uint64_t>(entry.packed_size, archive.bytes.size() + 1);
        // Rejects overlapping entries, which zip bombs use.
        if (n_packed > archive.bytes.size())
            throw DataError("the zip entries of the file overlap, so the file is damaged");
        arrays.push_back(read_array_from_zip_entry(archive, entry));
    }
    return arrays;
}

}  // namespace

std::vector<NamedArray> read_npz(const std::filesystem::path& path) {
    const ZipArchiveBytes archive{report_detail::read_file(path)};
    try {
        return parse_npz_arrays(archive);
    } catch (const DataError& error) {
        fail("cannot read npz '{}': {}", path.string(), error.what());
    }
}

NamedArray read_npy(const std::filesystem::path& path) {
    const std::vector<std::byte> bytes = report_detail::read_file(path);
    try {
        return report_detail::parse_npy(path.stem().string(), bytes);
    } catch (const DataError& error) {
        fail("cannot read npy '{}': {}", path.string(), error.what());
    }
}

}  // namespace relidar
