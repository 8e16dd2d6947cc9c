// SPDX-License-Identifier: Apache-2.0
// Reads little-endian numbers and byte strings with a length prefix.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include "base/fail.hpp"

namespace relidar::codecs {

static_assert(std::endian::native == std::endian::little,
              "numbers are read with the byte order of this machine, which must be little-endian");

class ByteReader {
public:
    explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

    template <class T>
    T read_number() {
        T value;
        std::memcpy(&value, read_bytes(sizeof value).data(), sizeof value);
        return value;
    }
    std::string_view read_bytes(std::uint64_t n_bytes) {
        if (n_bytes > bytes_.size() - at_)
            fail("the data are truncated: {} bytes are left, expected {}", bytes_.size() - at_, n_bytes);
        const std::string_view part = bytes_.substr(at_, std::size_t(n_bytes));
        at_ += std::size_t(n_bytes);
        return part;
    }
    std::string_view read_string() { return read_bytes(read_number<std::uint32_t>()); }
    std::size_t position() const { return at_; }
    std::size_t remaining() const { return bytes_.size() - at_; }
    std::string_view read_rest() { return read_bytes(remaining()); }

private:
    std::string_view bytes_;
    std::size_t at_ = 0;
};

template <class T>
T number_at(std::string_view bytes, std::size_t offset) {
    return ByteReader(bytes.substr(offset)).read_number<T>();
}

}  // namespace relidar::codecs
