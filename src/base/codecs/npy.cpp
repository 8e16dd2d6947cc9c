// SPDX-License-Identifier: Apache-2.0
// Writes and parses the header of a .npy file in numpy's format, for example:
//   {'descr': '<f4', 'fortran_order': False, 'shape': (66, 1030), }
#include "npy.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <set>
#include <span>

#include <fmt/format.h>

#include "named_array.hpp"

namespace relidar::codecs {
namespace {

constexpr std::string_view kNpyMagic{"\x93NUMPY", 6};
constexpr std::size_t kNpyAlignment = 64;

/// Parses the header of a .npy file, which is a Python dict, from left to right.
class NpyHeaderParser {
public:
    explicit NpyHeaderParser(std::string_view text) : text_(text) {}

    NpyHeader parse_header() {
        NpyHeader header;
        std::set<std::string> keys;
        expect_character('{');
        while (!accept_character('}')) {
            const std::string key = parse_string();
            expect_character(':');
            if (key == "descr") parse_type(header);
            else if (key == "fortran_order") header.fortran_order = parse_boolean();
            else if (key == "shape") header.shape = parse_tuple();
            else fail_header();
            keys.insert(key);
            end_item('}');
        }
        if (keys.size() < 3) fail_header();
        return header;
    }

private:
    [[noreturn]] static void fail_header() {
        fail("the npy header is malformed, expected a dict with descr, fortran_order and shape");
    }

    bool next_is(char character) {
        text_.remove_prefix(std::min(text_.find_first_not_of(" \n\t"), text_.size()));
        return text_.starts_with(character);
    }
    bool accept_character(char character) {
        if (!next_is(character)) return false;
        text_.remove_prefix(1);
        return true;
    }
    void expect_character(char character) {
        if (!accept_character(character)) fail_header();
    }
    /// A comma follows each item; it may be missing after the last one.
    void end_item(char end_of_items) {
        if (!accept_character(',') && !next_is(end_of_items)) fail_header();
    }
    std::string parse_string() {
        const char quote = next_is('"') ? '"' : '\'';
        expect_character(quote);
        const std::size_t end = std::min(text_.find(quote), text_.size());
        std::string result(text_.substr(0, end));
        text_.remove_prefix(end);
        expect_character(quote);
        return result;
    }
    bool parse_boolean() {
        const bool value = next_is('T');
        const std::string_view word = value ? "True" : "False";
        if (!text_.starts_with(word)) fail_header();
        text_.remove_prefix(word.size());
        return value;
    }
    /// Parses '<f4', or a list of fields such as [('x', '<f4'), ('rgb', '|u1', (3,))].
    void parse_type(NpyHeader& header) {
        if (!accept_character('[')) {
            header.type = parse_string();
            return;
        }
        while (!accept_character(']')) {
            expect_character('(');
            NpyField& field = header.fields.emplace_back();
            field.name = parse_string();
            expect_character(',');
            field.type = parse_string();
            if (accept_character(',') && next_is('(')) field.shape = parse_tuple();
            expect_character(')');
            end_item(']');
        }
    }
    std::size_t parse_integer() {
        next_is(' ');
        std::size_t value = 0;
        const auto [end, error] = std::from_chars(text_.data(), text_.data() + text_.size(), value);
        if (error != std::errc()) fail_header();
        text_.remove_prefix(std::size_t(end - text_.data()));
        accept_character('L');  // Accepts the suffix L, which Python 2 writes after long integers.
        return value;
    }
    ArrayShape parse_tuple() {
        ArrayShape result;
        expect_character('(');
        while (!accept_character(')')) {
            result.push_back(parse_integer());
            end_item(')');
        }
        return result;
    }

    std::string_view text_;
};

/// Returns the type without its byte order, for example "f4" for "<f4". Accepts "|" only
/// for types whose byte order does not matter.
std::string parse_dtype(const std::string& ordered_type) {
    const std::string type = ordered_type.substr(1);
    const std::size_t size = element_bytes(type);
    if (size == 0) fail("type '{}' is not supported", ordered_type);
    const bool has_no_order = size == 1 || type.starts_with('S');
    if (!ordered_type.starts_with('<') && !(has_no_order && ordered_type.starts_with('|')))
        fail("type '{}' is big-endian, expected little-endian", ordered_type);
    return type;
}

/// Reorders an array in Fortran order, in which the first index varies fastest.
void make_row_major(NamedArray& array) {
    const std::size_t value_bytes = element_bytes(array.dtype), n_dimensions = array.shape.size();
    const std::vector<std::byte> column_major = array.bytes;
    std::vector<std::size_t> index(n_dimensions, 0);  // of the current element, in all dimensions
    for (std::size_t target = 0; target < array.bytes.size(); target += value_bytes) {
        std::size_t source = 0;
        for (std::size_t d = n_dimensions; d-- > 0;) source = source * array.shape[d] + index[d];
        std::memcpy(array.bytes.data() + target, column_major.data() + source * value_bytes, value_bytes);
        // Row-major order: counts up the last index, and on overflow the one before it.
        for (std::size_t d = n_dimensions; d-- > 0;) {
            if (++index[d] < array.shape[d]) break;
            index[d] = 0;
        }
    }
}

}  // namespace

/// Returns the header of an .npy file, version 1.0: magic, version, the length of the
/// rest (2 bytes), and a Python dict with type, order and shape. Blanks at its end make
/// the size a multiple of kNpyAlignment, so that the values are aligned.
std::string make_npy_header(const NamedArray& array) {
    const char order = element_bytes(array.dtype) == 1 || array.dtype.starts_with('S') ? '|' : '<';
    std::string shape = fmt::format("{}", fmt::join(array.shape, ", "));
    if (array.shape.size() == 1) shape += ",";  // In Python, (n,) is a tuple but (n) is a number.
    std::string dict = fmt::format("{{'descr': '{}{}', 'fortran_order': False, 'shape': ({}), }}", order,
                                   array.dtype, shape);
    constexpr std::size_t kPrefixBytes = 10;  // Number of bytes of magic, version and length.
    const std::size_t unpadded_bytes = kPrefixBytes + dict.size() + 1;  // 1: the line break
    const std::size_t n_blocks = (unpadded_bytes + kNpyAlignment - 1) / kNpyAlignment;
    dict.resize(n_blocks * kNpyAlignment - kPrefixBytes - 1, ' ');
    dict += '\n';
    if (dict.size() > 0xFFFF)
        fail("array '{}' has {} dimensions, which are more than an npy file can store", array.name,
             array.shape.size());
    std::string header(kNpyMagic);
    header += {'\x01', '\x00', char(dict.size() & 0xFF), char(dict.size() >> 8)};
    return header + dict;
}

/// Parses the header of an .npy file: magic, version, length of the header, and the
/// header, which is a Python dict. Supports versions 1 to 3.
/// @throws DataError with the reason for any other version
NpyHeader parse_npy_header(std::string_view bytes) {
    if (bytes.size() < 12 || !bytes.starts_with(kNpyMagic))
        fail("the file does not begin like an .npy file, expected an array of NumPy");
    const int version = static_cast<unsigned char>(bytes[kNpyMagic.size()]);
    if (version < 1 || version > 3) fail("the file has npy version {}, expected 1 to 3", version);
    // The length of the header has 2 bytes in version 1, otherwise 4 bytes.
    const std::size_t n_length_bytes = version == 1 ? 2 : 4;
    const std::size_t length_begin = kNpyMagic.size() + 2;  // after two bytes with the version
    const std::size_t dict_begin = length_begin + n_length_bytes;
    std::size_t dict_bytes = 0;
    std::memcpy(&dict_bytes, bytes.data() + length_begin, n_length_bytes);  // little-endian
    if (dict_bytes > bytes.size() - dict_begin)
        fail("the npy header should have {} bytes, but only {} bytes are left", dict_bytes,
             bytes.size() - dict_begin);
    NpyHeader header = NpyHeaderParser(bytes.substr(dict_begin, dict_bytes)).parse_header();
    header.values = bytes.substr(dict_begin + dict_bytes);
    return header;
}

/// Parses an .npy file into an array of this name.
/// @throws DataError with the reason for a type or order that NamedArray does not support
NamedArray parse_npy(const std::string& name, std::string_view bytes) {
    const NpyHeader header = parse_npy_header(bytes);
    if (header.type.empty()) fail("the elements of the array have fields, expected plain numbers");
    NamedArray array{name, parse_dtype(header.type), header.shape, {}};
    const auto n_expected_bytes = array_bytes(array.shape, element_bytes(array.dtype));
    if (!n_expected_bytes || *n_expected_bytes != header.values.size())
        fail("the {} bytes of values do not fit the shape of the array", header.values.size());
    array.bytes.resize(header.values.size());
    std::ranges::copy(std::as_bytes(std::span(header.values)), array.bytes.begin());
    if (header.fortran_order) make_row_major(array);
    return array;
}

}  // namespace relidar::codecs
