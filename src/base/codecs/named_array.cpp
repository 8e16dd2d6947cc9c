// SPDX-License-Identifier: Apache-2.0
// Checks the names, types and shapes of arrays for the npz and safetensors codecs.
#include "named_array.hpp"
#include "base/fail.hpp"
#include "base/number_text.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <type_traits>

#include <fmt/ranges.h>
#include <glm/gtc/packing.hpp>

namespace relidar {
namespace {

/// A half-precision number (IEEE 754).
struct Half {
    std::uint16_t bits;

    template <class Number>
    explicit operator Number() const {
        return Number(glm::unpackHalf1x16(bits));
    }
};

template <class Out, class T>
std::vector<Out> convert_elements(const NamedArray& array) {
    std::vector<Out> result(array.bytes.size() / sizeof(T));
    for (std::size_t i = 0; i < result.size(); ++i) {
        T value;
        std::memcpy(&value, array.bytes.data() + i * sizeof(T), sizeof(T));
        result[i] = static_cast<Out>(value);
    }
    return result;
}

template <class Out>
using Converter = std::vector<Out> (*)(const NamedArray&);

/// Returns the function that converts elements of a NumPy type to `Out`; null if unknown.
template <class Out>
Converter<Out> find_converter(std::string_view dtype) {
    static constexpr std::array<std::pair<std::string_view, Converter<Out>>, 12> kConverters{
        {{"f2", convert_elements<Out, Half>},
         {"f4", convert_elements<Out, float>},
         {"f8", convert_elements<Out, double>},
         {"i1", convert_elements<Out, std::int8_t>},
         {"i2", convert_elements<Out, std::int16_t>},
         {"i4", convert_elements<Out, std::int32_t>},
         {"i8", convert_elements<Out, std::int64_t>},
         {"u1", convert_elements<Out, std::uint8_t>},
         {"u2", convert_elements<Out, std::uint16_t>},
         {"u4", convert_elements<Out, std::uint32_t>},
         {"u8", convert_elements<Out, std::uint64_t>},
         {"b1", convert_elements<Out, std::uint8_t>}}};
    for (const auto& [name, function] : kConverters)
        if (name == dtype) return function;
    return nullptr;
}

template <class Out>
std::vector<Out> convert_numeric(const NamedArray& array) {
    codecs::check_array(array);
    const Converter<Out> function = find_converter<Out>(array.dtype);
    if (!function)
        fail("array '{}' has values of the type '{}', expected numbers such as 'f4' or 'i4'", array.name,
             array.dtype);
    return function(array);
}

/// Returns the number of bytes after the first byte of a UTF-8 sequence, or 4 if the byte
/// cannot begin a sequence.
std::size_t utf8_tail_size(unsigned char first) {
    if (first < 0x80) return 0;
    if (first >> 5 == 6) return 1;
    if (first >> 4 == 14) return 2;
    return first >> 3 == 30 ? 3 : 4;
}

struct Utf8Sequence {
    char32_t code_point = 0xFFFD;  ///< the replacement character, unless the bytes are valid
    std::size_t n_bytes = 1;
};

/// Decodes the UTF-8 sequence at the begin of a text. An invalid one counts as one byte.
Utf8Sequence decode_sequence(std::string_view utf8) {
    // Smallest code point for each length of a sequence. A longer sequence for a smaller
    // code point is invalid (overlong encoding).
    constexpr char32_t kMinCodePoint[] = {0, 0x80, 0x800, 0x10000}, kMaxCodePoint = 0x10FFFF;
    const auto first = static_cast<unsigned char>(utf8[0]);
    const std::size_t n_tail = utf8_tail_size(first);  // bytes after the first; 4: invalid
    if (n_tail >= std::size(kMinCodePoint) || utf8.size() <= n_tail) return {};
    // The first byte has the upper bits. Each further byte, 10xxxxxx, has six bits.
    char32_t code_point = n_tail == 0 ? first : first & (0x3Fu >> n_tail);
    for (const char next : utf8.substr(1, n_tail)) {
        const auto byte = static_cast<unsigned char>(next);
        if ((byte & 0xC0) != 0x80) return {};
        code_point = code_point << 6 | (byte & 0x3F);
    }
    const bool is_surrogate = code_point >= 0xD800 && code_point <= 0xDFFF;  // only for UTF-16
    if (code_point < kMinCodePoint[n_tail] || code_point > kMaxCodePoint || is_surrogate) return {};
    return {code_point, 1 + n_tail};
}

/// Converts UTF-8 to Unicode code points. Replaces each invalid byte with U+FFFD.
std::u32string decode_utf8(std::string_view utf8) {
    std::u32string code_points;
    while (!utf8.empty()) {
        const Utf8Sequence sequence = decode_sequence(utf8);
        code_points.push_back(sequence.code_point);
        utf8.remove_prefix(sequence.n_bytes);
    }
    return code_points;
}

}  // namespace

namespace codecs {

std::size_t element_bytes(std::string_view numpy_type) {
    // Texts of a fixed number of characters: S has bytes, U has UTF-32.
    if (numpy_type.starts_with('S') || numpy_type.starts_with('U')) {
        const std::size_t n_characters = parse_integer<std::uint32_t>(numpy_type.substr(1)).value_or(0);
        return n_characters * (numpy_type[0] == 'U' ? sizeof(char32_t) : 1);
    }
    const bool is_number = find_converter<float>(numpy_type) != nullptr;
    return is_number ? std::size_t(numpy_type[1] - '0') : 0;  // "f4" has 4 bytes
}

std::optional<std::size_t> array_bytes(const ArrayShape& shape, std::size_t element_size_bytes) {
    std::size_t product = element_size_bytes;
    bool overflow = false, empty = false;
    for (std::size_t extent : shape) {
        empty = empty || extent == 0;
        overflow = __builtin_mul_overflow(product, extent, &product) || overflow;
    }
    if (empty) return 0;  // If any extent is 0, the array has no bytes.
    if (overflow) return std::nullopt;
    return product;
}

void check_array(const NamedArray& array) {
    if (array.name.empty()) throw DataError("an array has no name");
    const std::size_t size = element_bytes(array.dtype);
    if (size == 0) fail("array '{}' has the type '{}', which is not supported", array.name, array.dtype);
    const auto expected = array_bytes(array.shape, size);
    if (!expected || *expected != array.bytes.size())
        fail("array '{}' has {} bytes, which do not fit the shape [{}] and the type {}", array.name,
             array.bytes.size(), fmt::join(array.shape, ", "), array.dtype);
}

}  // namespace codecs

std::vector<float> NamedArray::to_floats() const { return convert_numeric<float>(*this); }
std::vector<double> NamedArray::to_doubles() const { return convert_numeric<double>(*this); }
std::size_t NamedArray::element_count() const {
    const auto n = codecs::array_bytes(shape, 1);
    if (!n) fail("array '{}' has the shape [{}], which is too large", name, fmt::join(shape, ", "));
    return *n;
}

const NamedArray* find_array(const std::vector<NamedArray>& arrays, std::string_view name) {
    const auto match = std::ranges::find(arrays, name, &NamedArray::name);
    return match == arrays.end() ? nullptr : &*match;
}

template <class T>
NamedArray make_array(std::string name, ArrayShape shape, const T* values, std::size_t count) {
    const char* dtype = std::is_same_v<T, float>    ? "f4"
                        : std::is_same_v<T, double> ? "f8"
                        : std::is_signed_v<T>       ? "i4"
                                                    : "u2";
    NamedArray array{std::move(name), dtype, std::move(shape), {}};
    if (array.element_count() != count)
        fail("array '{}' has {} values, expected {} for the shape [{}]", array.name, count,
             array.element_count(), fmt::join(array.shape, ", "));
    array.bytes.resize(count * sizeof(T));
    if (count > 0) std::memcpy(array.bytes.data(), values, array.bytes.size());
    return array;
}
template NamedArray make_array(std::string, ArrayShape, const float*, std::size_t);
template NamedArray make_array(std::string, ArrayShape, const double*, std::size_t);
template NamedArray make_array(std::string, ArrayShape, const std::int32_t*, std::size_t);
template NamedArray make_array(std::string, ArrayShape, const std::uint16_t*, std::size_t);

NamedArray single_text(std::string name, const std::string& text) {
    NamedArray array = make_text_array(std::move(name), {text});
    array.shape = {};
    return array;
}

NamedArray make_text_array(std::string name, const std::vector<std::string>& texts) {
    std::vector<std::u32string> decoded_texts;
    // Like NumPy, stores at least one character, even if all texts are empty.
    std::size_t max_length = 1;
    for (const std::string& text : texts) {
        decoded_texts.push_back(decode_utf8(text));
        max_length = std::max(max_length, decoded_texts.back().size());
    }
    const std::size_t text_bytes = max_length * sizeof(char32_t);
    NamedArray array{.name = std::move(name),
                     .dtype = fmt::format("U{}", max_length),
                     .shape = {texts.size()},
                     .bytes = std::vector<std::byte>(texts.size() * text_bytes)};
    for (std::size_t i = 0; i < decoded_texts.size(); ++i) {
        const std::u32string& text = decoded_texts[i];
        std::memcpy(array.bytes.data() + i * text_bytes, text.data(), text.size() * sizeof(char32_t));
    }
    return array;
}

}  // namespace relidar
