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

constexpr std::size_t kMostBytes = 65536;  // of a point
// Three bytes of LZF data decompress to at most this many bytes: length 7 + 255 + 2.
constexpr std::size_t kMostExpansion = 264;
constexpr std::size_t kMostPadding = 64;  // maximum size of the padding in a point, in bytes

/// The lines of the header. All lists have one entry per field.
struct PcdHeader {
    std::vector<std::string> names;
    std::vector<double> sizes, counts;                ///< bytes of a value, and values per point
    std::string types;                                ///< letters F, I or U, see PointField::kind
    double points = -1.0, width = 0.0, height = 1.0;  ///< points is -1 without the line POINTS
    std::string data;        ///< how the points are stored: ascii, binary or binary_compressed
    std::size_t length = 0;  ///< bytes of the header
};

/// Parses the numbers of a line of the header, which follow its first word. Limits them
/// to 1e9, so that their conversion to integers is always defined.
std::vector<double> parse_counts(const std::vector<std::string_view>& words, const std::string& where) {
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

/// Parses the text header of a PCD file. POINTS and COUNT may be missing. Their defaults
/// are WIDTH x HEIGHT and 1.
PcdHeader parse_pcd_header(std::string_view bytes, const std::string& where) {
    PcdHeader header;
    while (header.data.empty()) {
        const std::size_t end = bytes.find('\n', header.length);
        if (end == std::string_view::npos)
            fail("{}: the line DATA is missing, expected the header of a PCD file", where);
        const std::vector<std::string_view> words =
            split_words(bytes.substr(header.length, end - header.length));
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

/// Returns the fields of a point. Rejects fields whose numbers do not fit together. A
/// COUNT of 0 is allowed for fields that relidar ignores.
std::vector<PointField> list_pcd_fields(const PcdHeader& header, const std::string& where) {
    const std::size_t n = header.names.size();
    const bool are_equal = header.sizes.size() == n && header.types.size() == n && header.counts.size() == n;
    if (n == 0 || n > kMostFields || !are_equal)
        fail("{}: found {} FIELDS, {} SIZE, {} TYPE and {} COUNT, expected the same number of each, 1 to {}",
             where, n, header.sizes.size(), header.types.size(), header.counts.size(), kMostFields);
    std::vector<PointField> fields;
    double point_bytes = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        if (header.counts[i] < 1.0 && is_known_field(header.names[i]))
            fail("{}: COUNT of the field '{}' is 0, expected at least 1", where, quote(header.names[i]));
        point_bytes += header.sizes[i] * header.counts[i];
        fields.push_back({.name = header.names[i],
                          .kind = header.types[i],
                          .size = std::size_t(header.sizes[i]),
                          .count = std::size_t(header.counts[i])});
    }
    if (point_bytes > double(kMostBytes))
        fail("{}: a point has {} bytes (SIZE and COUNT), expected at most {}", where, point_bytes,
             kMostBytes);
    return fields;
}

/// Unit in which the size of a point is measured: numbers of a text file, or bytes.
enum class PointUnit { values, bytes };

/// Decides whether fields with COUNT 0 ("empty" fields) exist. Some programs write it for
/// padding that the file does not have, others for padding that it has. The extra size,
/// that of a point minus that of its other fields, decides:
/// - none: the empty fields do not exist and are removed;
/// - one value for each empty field: their COUNT becomes 1;
/// - any other: a single empty field becomes padding of this size; several are an error.
/// @param point_size  size of a point in the file, in values or bytes
void set_empty_counts(std::vector<PointField>& fields, std::size_t point_size, PointUnit unit,
                      const std::string& where) {
    // empty_size: size of the empty fields if each has one value
    std::size_t nonempty_size = 0, empty_size = 0, n_empty = 0;
    for (const PointField& field : fields) {
        const std::size_t value_size = unit == PointUnit::values ? 1 : field.size;
        nonempty_size += value_size * field.count;
        if (field.count > 0) continue;
        empty_size += value_size;
        ++n_empty;
    }
    std::size_t extra_size = point_size - std::min(nonempty_size, point_size);
    if (extra_size > kMostPadding) extra_size = 0;  // other data follows the points
    const auto is_empty = [](const PointField& field) { return field.count == 0; };
    if (extra_size == 0) {
        std::erase_if(fields, is_empty);
        return;
    }
    if (n_empty > 1 && extra_size != empty_size)
        fail(
            "{}: {} fields have COUNT 0, and a point has {} more {} than the other fields, expected 0 or {} "
            "more",
            where, n_empty, extra_size, unit == PointUnit::values ? "values" : "bytes", empty_size);
    for (PointField& field : fields) {
        if (!is_empty(field)) continue;
        if (extra_size == empty_size) field.count = 1;
        else field = {.name = std::string(kPaddingName), .kind = 'U', .size = 1, .count = extra_size};
    }
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
    std::size_t at = 0;  // next byte of the input
    const auto read_byte = [&]() -> std::size_t {
        if (at >= compressed_data.size()) fail_lzf(where);
        return static_cast<unsigned char>(compressed_data[at++]);
    };
    while (at < compressed_data.size()) {
        const std::size_t control = read_byte();
        if (control < 32) {
            const std::size_t n_copied = control + 1;
            if (n_copied > compressed_data.size() - at || n_copied > size - out.size()) fail_lzf(where);
            out.append(compressed_data.substr(at, n_copied));
            at += n_copied;
            continue;
        }
        // The upper 3 bits are the length minus 2, continued in the next byte if they are
        // 7. The lower 5 bits and one more byte are the distance minus 1.
        std::size_t length = control >> 5;
        if (length == 7) length += read_byte();
        length += 2;
        const std::size_t distance = ((control & 31) << 8) + read_byte() + 1;
        if (distance > out.size() || length > size - out.size()) fail_lzf(where);
        // Copies byte by byte, because the source can overlap the appended bytes.
        for (std::size_t i = 0; i < length; ++i) out += out[out.size() - distance];
    }
    if (out.size() != size) fail_lzf(where);
    return out;
}

/// Decompresses the points of a file. The data consist of the compressed size, the
/// decompressed size, and LZF data. The result stores one field after another.
std::string decompress_points(std::string_view compressed_data, const std::string& where) {
    constexpr std::size_t kSizesBytes = 8;
    if (compressed_data.size() < kSizesBytes)
        fail("{}: the file is truncated: found {} bytes after the header, expected at least {}", where,
             compressed_data.size(), kSizesBytes);
    codecs::ByteReader reader(compressed_data);
    const auto packed = reader.read_number<std::uint32_t>(), unpacked = reader.read_number<std::uint32_t>();
    compressed_data = reader.read_rest();
    if (packed > compressed_data.size() || unpacked / kMostExpansion > packed)
        fail("{}: {} bytes of compressed data cannot unpack to {} bytes; the file has {} bytes", where,
             packed, unpacked, compressed_data.size());
    return decompress_lzf(compressed_data.substr(0, packed), unpacked, where);
}

}  // namespace

PointTable parse_pcd(const SharedBytes& file, const std::string& where) {
    const PcdHeader header = parse_pcd_header(file.bytes, where);
    // Fields with COUNT 0 are resolved below, because this needs the size of a point.
    std::vector<PointField> fields = list_pcd_fields(header, where);
    const std::string_view data = file.bytes.substr(header.length);
    const std::size_t n = std::size_t(header.points);
    check_point_count(n, where);  // at least 1
    if (header.data == "ascii") {
        const std::string_view first_line = data.substr(0, data.find('\n'));
        set_empty_counts(fields, split_words(first_line).size(), PointUnit::values, where);
        return parse_lines(data, fields, n, where);
    }
    if (header.data == "binary") {
        set_empty_counts(fields, data.size() / n, PointUnit::bytes, where);
        return table_of_records(file.share_part(data), fields, n, PointMemoryLayout::by_point, where);
    }
    if (header.data == "binary_compressed") {
        const SharedBytes points = share_bytes(decompress_points(data, where));
        set_empty_counts(fields, points.bytes.size() / n, PointUnit::bytes, where);
        return table_of_records(points, fields, n, PointMemoryLayout::by_field, where);
    }
    fail("{}: found DATA '{}', expected ascii, binary or binary_compressed", where, quote(header.data));
}

}  // namespace relidar::read
