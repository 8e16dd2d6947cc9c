// SPDX-License-Identifier: Apache-2.0
// Writes Common Data Representation (CDR), the serialisation format of ROS 2 messages.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "base/bytes.hpp"

namespace relidar::codecs {

/// Little-endian. Numbers are aligned to their size, counted from the end of the header.
class CdrWriter {
public:
    template <class T>
    CdrWriter& append_aligned_number(T value) {
        while ((bytes_.size() - kHead) % sizeof(T) != 0) bytes_ += '\0';
        append_binary_value(bytes_, value);
        return *this;
    }
    CdrWriter& append_string(std::string_view text) {
        append_aligned_number(std::uint32_t(text.size() + 1));
        bytes_ += text;
        bytes_ += '\0';
        return *this;
    }
    CdrWriter& append_byte_sequence(std::string_view bytes) {
        append_aligned_number(std::uint32_t(bytes.size()));
        bytes_ += bytes;
        return *this;
    }
    std::string take_encoded_message() { return std::move(bytes_); }

private:
    static constexpr std::size_t kHead = 4;
    std::string bytes_ = std::string("\0\1\0\0", kHead);
};

}  // namespace relidar::codecs
