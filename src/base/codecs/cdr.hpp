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
    CdrWriter& add_number(T value) {
        while ((bytes_.size() - kHeaderBytes) % sizeof(T) != 0) bytes_ += '\0';
        append_raw(bytes_, value);
        return *this;
    }
    CdrWriter& append_string(std::string_view text) {
        add_number(std::uint32_t(text.size() + 1));
        bytes_ += text;
        bytes_ += '\0';
        return *this;
    }
    CdrWriter& add_bytes(std::string_view bytes) {
        add_number(std::uint32_t(bytes.size()));
        bytes_ += bytes;
        return *this;
    }
    std::string take_message() { return std::move(bytes_); }

private:
    static constexpr std::size_t kHeaderBytes = 4;
    std::string bytes_ = std::string("\0\1\0\0", kHeaderBytes);
};

}  // namespace relidar::codecs
