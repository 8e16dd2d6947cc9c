// SPDX-License-Identifier: Apache-2.0
// Writes and parses the header of a .npy file in numpy's format, for example:
//   {'descr': '<f4', 'fortran_order': False, 'shape': (66, 1030), }
//
// Accepts only the types that NamedArray supports. Rejects big-endian numbers, Fortran
// order, structs and objects, each with a separate message.
#include "npy.hpp"

#include <charconv>
#include <cstring>
#include <optional>
#include <string_view>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "named_array.hpp"

namespace relidar::report_detail {
namespace {

constexpr std::string_view kNpyMagic{"\x93NUMPY", 6};
constexpr std::size_t kAlignment = 64;

/// Parses the header of a .npy file, which is a Python dict, from left to right.
class HeaderParser {
public:
    explicit HeaderParser(std::string_view text) : text_(text) {}

    void parse() {
        expect('{');
        while (!accept('}')) {
            const std::string key = quoted();
            expect(':');
            if (key == "descr")
                descr = peek('[') ? refuse("contains a struct type, expected a plain number type") : quoted();
            else if (key == "fortran_order") fortran_order = boolean();
            else if (key == "shape") shape = tuple();
            else refuse("has the unknown key '" + key + "'");
            if (!accept(',') && !peek('}')) refuse("is malformed");
        }
        if (!descr || !fortran_order || !shape)
            refuse("has no descr, fortran_order or shape, expected all of them");
    }

    std::optional<std::string> descr;
    std::optional<bool> fortran_order;
    std::optional<std::vector<std::size_t>> shape;

private:
    [[noreturn]] static std::string refuse(const std::string& why) {
        throw DataError("the npy header " + why);
    }

    bool peek(char character) {
        while (!text_.empty() && (text_[0] == ' ' || text_[0] == '\n' || text_[0] == '\t'))
            text_.remove_prefix(1);
        return !text_.empty() && text_[0] == character;
    }
    bool accept(char character) {
        if (!peek(character)) return false;
        text_.remove_prefix(1);
        return true;
    }
    void expect(char character) {
        if (!accept(character)) refuse("is malformed");
    }
    bool accept_word(std::string_view word) {
        peek(' ');
        if (!text_.starts_with(word)) return false;
        text_.remove_prefix(word.size());
        return true;
    }
    std::string quoted() {
        const char quote = peek('"') ? '"' : '\'';
        expect(quote);
        const std::size_t end = text_.find(quote);
        if (end == std::string_view::npos) refuse("is malformed");
        std::string result(text_.substr(0, end));
        text_.remove_prefix(end + 1);
        return result;
    }
    bool boolean() {
        if (accept_word("True")) return true;
        if (accept_word("False")) return false;
        refuse("is malformed");
    }
    std::size_t integer() {
        peek(' ');
        std::size_t value = 0;
        const auto [end, error] = std::from_chars(text_.data(), text_.data() + text_.size(), value);
        if (error != std::errc()) refuse("contains an invalid shape");
        text_.remove_prefix(std::size_t(end - text_.data()));
        accept('L');  // Accepts the suffix L, which Python 2 writes after long integers.
        return value;
    }
    std::vector<std::size_t> tuple() {
        std::vector<std::size_t> result;
        expect('(');
        while (!accept(')')) {
            result.push_back(integer());
            if (!accept(',') && !peek(')')) refuse("is malformed");
        }
        return result;
    }

    std::string_view text_;
};

std::string parse_type_descriptor(const std::string& descr) {
    const std::string_view type = std::string_view(descr).substr(descr.empty() ? 0 : 1);
    const char order = descr.empty() ? '?' : descr[0];
    const std::size_t size = get_item_size(type);
    if (size == 0) throw DataError(fmt::format("type '{}' is not supported", descr));
    if (order != '<' && !(order == '|' && (size == 1 || type.starts_with('S'))))
        throw DataError(fmt::format("type '{}' is not little-endian", descr));
    return std::string(type);
}

std::uint32_t little_endian(const std::byte* bytes, std::size_t count) {
    std::uint32_t value = 0;
    std::memcpy(&value, bytes, count);
    return value;
}

}  // namespace

std::string make_npy_header(const NamedArray& array) {
    const char order = get_item_size(array.dtype) == 1 || array.dtype.starts_with('S') ? '|' : '<';
    std::string shape;
    for (std::size_t extent : array.shape) shape += fmt::format("{}, ", extent);
    if (array.shape.size() > 1) shape.resize(shape.size() - 2);
    // Keeps the trailing comma if the shape has only one extent. In Python, (n,) is a
    // tuple but (n) is a number.
    if (array.shape.size() == 1) shape.pop_back();
    std::string dict = fmt::format("{{'descr': '{}{}', 'fortran_order': False, 'shape': ({}), }}", order,
                                   array.dtype, shape);
    constexpr std::size_t kPrefix = 10;  // Number of bytes of magic, version and length.
    const std::size_t total = (kPrefix + dict.size() + 1 + kAlignment - 1) / kAlignment * kAlignment;
    dict.resize(total - kPrefix - 1, ' ');
    dict += '\n';
    if (dict.size() > 0xFFFF)
        throw DataError(
            fmt::format("array '{}' has {} dimensions, which is too many", array.name, array.shape.size()));
    std::string header(kNpyMagic);
    header += {'\x01', '\x00', char(dict.size() & 0xFF), char(dict.size() >> 8)};
    return header + dict;
}

NamedArray parse_npy(const std::string& name, const std::vector<std::byte>& bytes) {
    if (bytes.size() < 12 || std::memcmp(bytes.data(), kNpyMagic.data(), kNpyMagic.size()) != 0)
        throw DataError("the file is not a .npy array");
    const auto version = std::to_integer<int>(bytes[6]);
    if (version < 1 || version > 3)
        throw DataError(fmt::format("the file has npy version {}, expected 1 to 3", version));
    const std::size_t n_length = version == 1 ? 2 : 4, start = 8 + n_length;
    const std::size_t length = little_endian(bytes.data() + 8, n_length);
    if (length > bytes.size() - start)
        throw DataError(fmt::format("the npy header should have {} bytes, but only {} bytes are left", length,
                                    bytes.size() - start));

    HeaderParser header({reinterpret_cast<const char*>(bytes.data()) + start, length});
    header.parse();
    NamedArray array{name, parse_type_descriptor(*header.descr), *header.shape, {}};
    if (*header.fortran_order)
        throw DataError("the values are in Fortran (column-major) order, expected row-major");
    const auto expected = compute_byte_count(array.shape, get_item_size(array.dtype));
    const std::size_t found = bytes.size() - start - length;
    if (!expected || *expected != found)
        throw DataError(fmt::format("the {} bytes of values do not fit the shape of the array", found));
    array.bytes.assign(bytes.end() - std::ptrdiff_t(found), bytes.end());
    return array;
}

}  // namespace relidar::report_detail
