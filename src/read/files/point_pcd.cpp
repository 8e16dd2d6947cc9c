// SPDX-License-Identifier: Apache-2.0
// Reads PCD 0.7 files. The points follow a text header. They are stored as text, as
// binary, or as binary compressed with LZF. Compressed points are stored field by field.
#include <cstdint>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/point_table.hpp"

namespace relidar::read {
namespace {

constexpr std::size_t kMostPcdFields = 256, kMostBytes = 65536;  // limits per point
// Three bytes of LZF data decompress to at most this many bytes.
constexpr std::size_t kMostExpansion = 264;
constexpr std::size_t kMostPadding = 64;  // maximum size of the padding in a point, in bytes

struct PcdHeader {
    std::vector<std::string> names;
    std::vector<double> sizes, counts;
    std::string types;  ///< one letter per field
    double points = -1.0, width = 0.0, height = 1.0;
    std::string data;
    std::size_t length = 0;  ///< bytes of the header
};

/// Limits the numbers to 1e9, so that their conversion to integers is always defined.
std::vector<double> parse_counts(const std::vector<std::string>& words, const std::string& where) {
    std::vector<double> numbers;
    for (std::size_t i = 1; i < words.size(); ++i) {
        const auto number = parse_number(words[i]);
        if (!number || !(*number >= 0.0 && *number <= 1e9) || *number != double(std::int64_t(*number)))
            fail("{}: found {} '{}', expected a whole number", where, words[0], quote(words[i]));
        numbers.push_back(*number);
    }
    if (numbers.empty()) fail("{}: the line {} has no number, expected at least one", where, words[0]);
    return numbers;
}

/// POINTS and COUNT may be missing. Their defaults are WIDTH x HEIGHT and 1.
PcdHeader parse_pcd_header(std::string_view bytes, const std::string& where) {
    PcdHeader header;
    while (header.data.empty()) {
        const std::size_t end = bytes.find('\n', header.length);
        if (end == std::string_view::npos)
            fail("{}: the line DATA is missing, expected the header of a PCD file", where);
        const std::vector<std::string> words = split_words(bytes.substr(header.length, end - header.length));
        header.length = end + 1;
        if (words.empty() || words[0].front() == '#') continue;
        if (words[0] == "FIELDS") header.names.assign(words.begin() + 1, words.end());
        else if (words[0] == "SIZE") header.sizes = parse_counts(words, where);
        else if (words[0] == "COUNT") header.counts = parse_counts(words, where);
        else if (words[0] == "WIDTH") header.width = parse_counts(words, where)[0];
        else if (words[0] == "HEIGHT") header.height = parse_counts(words, where)[0];
        else if (words[0] == "POINTS") header.points = parse_counts(words, where)[0];
        else if (words[0] == "TYPE")
            for (std::size_t i = 1; i < words.size(); ++i) header.types += words[i].front();
        else if (words[0] == "DATA") header.data = words.size() == 2 ? words[1] : "?";
        else if (words[0] != "VERSION" && words[0] != "VIEWPOINT")
            fail("{}: found a line that starts with '{}', expected the header of a PCD file", where,
                 quote(words[0]));
    }
    if (header.points < 0.0) header.points = header.width * header.height;
    if (header.counts.empty()) header.counts.assign(header.names.size(), 1.0);
    return header;
}

/// A COUNT of 0 is allowed for fields that relidar ignores.
std::vector<PointField> list_pcd_fields(const PcdHeader& header, const std::string& where) {
    const std::size_t n = header.names.size();
    if (n == 0 || n > kMostPcdFields || header.sizes.size() != n || header.types.size() != n ||
        header.counts.size() != n)
        fail("{}: found {} FIELDS, {} SIZE, {} TYPE and {} COUNT, expected the same number of each, 1 to {}",
             where, n, header.sizes.size(), header.types.size(), header.counts.size(), kMostPcdFields);
    std::vector<PointField> fields;
    double record = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        if (header.counts[i] < 1.0 && is_known_field(header.names[i]))
            fail("{}: COUNT of the field '{}' is 0, expected at least 1", where, quote(header.names[i]));
        record += header.sizes[i] * header.counts[i];
        fields.push_back(
            {header.names[i], header.types[i], std::size_t(header.sizes[i]), std::size_t(header.counts[i])});
    }
    if (record > double(kMostBytes))
        fail("{}: a point has {} bytes (SIZE and COUNT), expected at most {}", where, record, kMostBytes);
    return fields;
}

/// Decides which fields with COUNT 0 exist: some programs write COUNT 0 for padding that
/// the file does not have, others for padding that it has.
/// @param record  values per point (text) or bytes per point that the file has
void resolve_empty(std::vector<PointField>& fields, std::size_t record, bool text, const std::string& where) {
    std::size_t known = 0, of_empty = 0, n_empty = 0;
    for (const PointField& field : fields) {
        known += (text ? 1 : field.size) * field.count;
        n_empty += field.count == 0;
        of_empty += field.count == 0 ? (text ? 1 : field.size) : 0;
    }
    const std::size_t more = record - std::min(known, record), missing = more > kMostPadding ? 0 : more;
    const bool has_one_value_each = missing == of_empty;
    if (n_empty > 1 && missing > 0 && !has_one_value_each)
        fail(
            "{}: {} fields have COUNT 0, and a point has {} more {} than the other fields, expected 0 or {} "
            "more",
            where, n_empty, missing, text ? "values" : "bytes", of_empty);
    std::erase_if(fields, [&](PointField& field) {
        if (field.count > 0) return false;
        if (has_one_value_each) field.count = 1;
        else field = {std::string(kPaddingName), 'U', 1, missing};
        return missing == 0;
    });
}

[[noreturn]] void fail_lzf(const std::string& where) {
    fail("{}: the compressed data is damaged, expected LZF data of the size in the file", where);
}

/// Decompresses LZF data. A byte b below 32 precedes b + 1 bytes that are copied. A
/// larger byte starts a reference of two or three bytes: length and distance of earlier
/// output to repeat.
/// @param size  expected size of the result
std::string decompress_lzf(std::string_view compressed_data, std::size_t size, const std::string& where) {
    std::string out;
    out.reserve(size);
    std::size_t at = 0;
    const auto next = [&] {
        return at < compressed_data.size() ? std::size_t(static_cast<unsigned char>(compressed_data[at++]))
                                           : (fail_lzf(where), 0);
    };
    while (at < compressed_data.size()) {
        const std::size_t control = next();
        if (control < 32) {
            if (control + 1 > compressed_data.size() - at || control + 1 > size - out.size()) fail_lzf(where);
            out.append(compressed_data.substr(at, control + 1));
            at += control + 1;
            continue;
        }
        // The upper 3 bits are the length minus 2, continued in the next byte if they are
        // 7. The lower 5 bits and one more byte are the distance minus 1.
        std::size_t length = control >> 5;
        if (length == 7) length += next();
        length += 2;
        const std::size_t back = ((control & 31) << 8) + next() + 1;
        if (back > out.size() || length > size - out.size()) fail_lzf(where);
        // Copies byte by byte, because the copied bytes may overlap the bytes that this
        // loop appends.
        for (std::size_t i = 0; i < length; ++i) out += out[out.size() - back];
    }
    if (out.size() != size) fail_lzf(where);
    return out;
}

/// Decompresses the points of a file. The data consist of the compressed size, the
/// decompressed size, and LZF data. The result stores one field after another.
std::string decompress_points(std::string_view compressed_data, const std::string& where) {
    if (compressed_data.size() < 8)
        fail("{}: the file is truncated: found {} bytes after the header, expected at least 8", where,
             compressed_data.size());
    codecs::ByteReader reader(compressed_data);
    const auto packed = reader.read_number<std::uint32_t>(), size = reader.read_number<std::uint32_t>();
    compressed_data = reader.read_rest();
    if (packed > compressed_data.size() || size / kMostExpansion > packed)
        fail("{}: {} bytes of compressed data cannot unpack to {} bytes; the file has {} bytes", where,
             packed, size, compressed_data.size());
    return decompress_lzf(compressed_data.substr(0, packed), size, where);
}

}  // namespace

PointTable parse_pcd(const SharedBytes& file, const std::string& where) {
    const PcdHeader header = parse_pcd_header(file.bytes, where);
    std::vector<PointField> fields = list_pcd_fields(header, where);
    const std::string_view data = file.bytes.substr(header.length);
    const std::size_t n = std::size_t(header.points);
    check_point_count(n, where);
    // resolve_empty() gets the values per point of a text file (true), or the bytes per
    // point of a binary file (false).
    if (header.data == "ascii") {
        resolve_empty(fields, split_words(data.substr(0, data.find('\n'))).size(), true, where);
        return parse_lines(data, fields, n, where);
    }
    if (header.data == "binary") {
        resolve_empty(fields, data.size() / n, false, where);
        return table_of_records(file.share_part(data), fields, n, PointMemoryLayout::by_point, where);
    }
    if (header.data == "binary_compressed") {
        const SharedBytes points = share_bytes(decompress_points(data, where));
        resolve_empty(fields, points.bytes.size() / n, false, where);
        return table_of_records(points, fields, n, PointMemoryLayout::by_field, where);
    }
    fail("{}: found DATA '{}', expected ascii, binary or binary_compressed", where, quote(header.data));
}

}  // namespace relidar::read
