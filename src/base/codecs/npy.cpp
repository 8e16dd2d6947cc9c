// SPDX-License-Identifier: Apache-2.0
// Writes and parses the header of a .npy file in numpy's format, for example:
//   {'descr': '<f4', 'fortran_order': False, 'shape': (66, 1030), }
//
// Accepts only the types that NamedArray supports. Rejects big-endian numbers, structs
// and objects, each with a separate message.
#include "npy.hpp"
#include "base/fail.hpp"

#include <charconv>
#include <cstring>

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

    void parse_header() {
        expect_character('{');
        while (!accept_character('}')) {
            const std::string key = parse_string();
            expect_character(':');
            if (key == "descr") {
                if (next_is('[')) fail_header("contains a struct type, expected a plain number type");
                descr = parse_string();
            } else if (key == "fortran_order") fortran_order = parse_boolean();
            else if (key == "shape") shape = parse_tuple();
            else fail_header("has the unknown key '" + key + "'");
            if (!accept_character(',') && !next_is('}')) fail_header("is malformed");
        }
        if (!descr || !fortran_order || !shape)
            fail_header("has no descr, fortran_order or shape, expected all of them");
    }

    std::optional<std::string> descr;
    std::optional<bool> fortran_order;
    std::optional<std::vector<std::size_t>> shape;

private:
    [[noreturn]] static void fail_header(const std::string& reason) {
        throw DataError("the npy header " + reason);
    }

    bool next_is(char character) {
        while (!text_.empty() && (text_[0] == ' ' || text_[0] == '\n' || text_[0] == '\t'))
            text_.remove_prefix(1);
        return !text_.empty() && text_[0] == character;
    }
    bool accept_character(char character) {
        if (!next_is(character)) return false;
        text_.remove_prefix(1);
        return true;
    }
    void expect_character(char character) {
        if (!accept_character(character)) fail_header("is malformed");
    }
    bool accept_word(std::string_view word) {
        next_is(' ');
        if (!text_.starts_with(word)) return false;
        text_.remove_prefix(word.size());
        return true;
    }
    std::string parse_string() {
        const char quote = next_is('"') ? '"' : '\'';
        expect_character(quote);
        const std::size_t end = text_.find(quote);
        if (end == std::string_view::npos) fail_header("is malformed");
        std::string result(text_.substr(0, end));
        text_.remove_prefix(end + 1);
        return result;
    }
    bool parse_boolean() {
        if (accept_word("True")) return true;
        if (accept_word("False")) return false;
        fail_header("is malformed");
    }
    std::size_t parse_integer() {
        next_is(' ');
        std::size_t value = 0;
        const auto [end, error] = std::from_chars(text_.data(), text_.data() + text_.size(), value);
        if (error != std::errc()) fail_header("contains an invalid shape, expected whole numbers");
        text_.remove_prefix(std::size_t(end - text_.data()));
        accept_character('L');  // Accepts the suffix L, which Python 2 writes after long integers.
        return value;
    }
    std::vector<std::size_t> parse_tuple() {
        std::vector<std::size_t> result;
        expect_character('(');
        while (!accept_character(')')) {
            result.push_back(parse_integer());
            if (!accept_character(',') && !next_is(')')) fail_header("is malformed");
        }
        return result;
    }

    std::string_view text_;
};

/// Returns the type without its byte order, for example "f4" for "<f4". Accepts "|" only
/// for types whose byte order does not matter.
std::string parse_dtype(const std::string& numpy_type_with_byte_order) {
    const std::string_view type =
        std::string_view(numpy_type_with_byte_order).substr(numpy_type_with_byte_order.empty() ? 0 : 1);
    const char order = numpy_type_with_byte_order.empty() ? '?' : numpy_type_with_byte_order[0];
    const std::size_t size = element_bytes(type);
    if (size == 0) fail("type '{}' is not supported", numpy_type_with_byte_order);
    if (order != '<' && !(order == '|' && (size == 1 || type.starts_with('S'))))
        fail("type '{}' is big-endian, expected little-endian", numpy_type_with_byte_order);
    return std::string(type);
}

/// Reorders an array in Fortran order, in which the first index varies fastest.
void make_row_major(NamedArray& array) {
    const std::size_t size = element_bytes(array.dtype), n_dimensions = array.shape.size();
    const std::vector<std::byte> column_major = array.bytes;
    std::vector<std::size_t> index(n_dimensions, 0);
    for (std::size_t to = 0; to < array.bytes.size(); to += size) {
        std::size_t from = 0;
        for (std::size_t d = n_dimensions; d-- > 0;) from = from * array.shape[d] + index[d];
        std::memcpy(array.bytes.data() + to, column_major.data() + from * size, size);
        for (std::size_t d = n_dimensions; d-- > 0 && ++index[d] == array.shape[d];) index[d] = 0;
    }
}

}  // namespace

std::string make_npy_header(const NamedArray& array) {
    const char order = element_bytes(array.dtype) == 1 || array.dtype.starts_with('S') ? '|' : '<';
    std::string shape;
    for (std::size_t extent : array.shape) shape += fmt::format("{}, ", extent);
    if (array.shape.size() > 1) shape.resize(shape.size() - 2);
    // Removes the space, but not the comma, after a single extent. In Python, (n,) is a
    // tuple but (n) is a number.
    if (array.shape.size() == 1) shape.pop_back();
    std::string dict = fmt::format("{{'descr': '{}{}', 'fortran_order': False, 'shape': ({}), }}", order,
                                   array.dtype, shape);
    constexpr std::size_t kPrefixBytes = 10;  // Number of bytes of magic, version and length.
    // numpy pads the header with blanks, so that the values are aligned.
    const std::size_t total =
        (kPrefixBytes + dict.size() + 1 + kNpyAlignment - 1) / kNpyAlignment * kNpyAlignment;
    dict.resize(total - kPrefixBytes - 1, ' ');
    dict += '\n';
    if (dict.size() > 0xFFFF)
        fail("array '{}' has {} dimensions, which are more than an npy file can store", array.name,
             array.shape.size());
    std::string header(kNpyMagic);
    header += {'\x01', '\x00', char(dict.size() & 0xFF), char(dict.size() >> 8)};
    return header + dict;
}

NamedArray parse_npy(const std::string& name, const std::vector<std::byte>& bytes) {
    if (bytes.size() < 12 || std::memcmp(bytes.data(), kNpyMagic.data(), kNpyMagic.size()) != 0)
        throw DataError("the file does not begin like an .npy file, expected an array of NumPy");
    const auto version = std::to_integer<int>(bytes[6]);
    if (version < 1 || version > 3) fail("the file has npy version {}, expected 1 to 3", version);
    // The length of the header has 2 bytes in version 1, otherwise 4 bytes.
    const std::size_t n_length = version == 1 ? 2 : 4, start = 8 + n_length;
    std::size_t length = 0;  // size of the header, stored in little-endian order
    std::memcpy(&length, bytes.data() + 8, n_length);
    if (length > bytes.size() - start)
        fail("the npy header should have {} bytes, but only {} bytes are left", length, bytes.size() - start);

    NpyHeaderParser header({reinterpret_cast<const char*>(bytes.data()) + start, length});
    header.parse_header();
    NamedArray array{name, parse_dtype(*header.descr), *header.shape, {}};
    const auto n_expected_bytes = array_bytes(array.shape, element_bytes(array.dtype));
    const std::size_t n_value_bytes = bytes.size() - start - length;
    if (!n_expected_bytes || *n_expected_bytes != n_value_bytes)
        fail("the {} bytes of values do not fit the shape of the array", n_value_bytes);
    array.bytes.assign(bytes.end() - std::ptrdiff_t(n_value_bytes), bytes.end());
    if (*header.fortran_order) make_row_major(array);
    return array;
}

}  // namespace relidar::codecs
