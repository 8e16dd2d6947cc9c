// SPDX-License-Identifier: Apache-2.0
// Reads the fields of a ROS message one after another. ROS 2 messages are CDR in either
// byte order (XCDR1 and plain XCDR2). ROS 1 messages are little-endian values without
// padding.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"

namespace relidar::bag {

class MessageReader {
public:
    /// Creates a reader for one message. Checks the CDR header of a ROS 2 message.
    /// @throws DataError if the first bytes are not a CDR header
    MessageReader(std::string_view bytes, bool is_ros1) : bytes_(bytes), is_ros1_(is_ros1) {
        if (is_ros1) return;
        constexpr std::size_t kHead = 4;
        if (bytes.size() < kHead)
            fail(
                "the message has only {} bytes, expected at least the {} bytes of the header of a ROS 2 "
                "message (CDR format)",
                bytes.size(), kHead);
        // The second byte is the encoding: XCDR version 1 (0 and 1) or version 2 (6 and
        // 7). Odd numbers mean little-endian.
        const auto kind = static_cast<unsigned char>(bytes[1]);
        if (bytes[0] != 0 || (kind != 0 && kind != 1 && kind != 6 && kind != 7))
            fail(
                "the message begins with {:02x} {:02x}, expected a CDR header: 00 00, 00 01, 00 06 or 00 "
                "07{}",
                static_cast<unsigned char>(bytes[0]), kind,
                bytes.starts_with("\x28\xb5\x2f\xfd") ? " (damaged zstd data)" : "");
        swapped_ = kind % 2 == 0;
        widest_ = kind >= 6 ? 4 : 8;
        bytes_ = bytes.substr(kHead);
    }

    bool is_ros1() const { return is_ros1_; }
    bool is_byte_order_swapped() const { return swapped_; }

    template <class T>
    T read_number() {
        if (!is_ros1_) skip_alignment_padding(std::min(sizeof(T), widest_));
        char raw[sizeof(T)];
        std::memcpy(raw, read_bytes(sizeof(T)).data(), sizeof(T));
        if (swapped_) std::reverse(raw, raw + sizeof(T));
        T value;
        std::memcpy(&value, raw, sizeof(T));
        return value;
    }
    /// Reads a string. Removes the terminating 0, which CDR counts in the length.
    std::string_view read_string() {
        std::string_view text = read_bytes(read_number<std::uint32_t>());
        if (!is_ros1_ && !text.empty() && text.back() == '\0') text.remove_suffix(1);
        return text;
    }
    /// Reads the number of entries of a list.
    /// @param min_entry_bytes  minimum size of an entry in bytes
    /// @throws DataError if the rest of the message is too short for so many entries
    std::size_t read_list_length(std::size_t min_entry_bytes) {
        const auto n = read_number<std::uint32_t>();
        if (n > (bytes_.size() - at_) / min_entry_bytes)
            fail(
                "the message has a list of {} entries, but only {} bytes are left in the message, which can "
                "hold at most {} entries",
                n, bytes_.size() - at_, (bytes_.size() - at_) / min_entry_bytes);
        return n;
    }
    std::string_view read_bytes(std::size_t n_bytes) {
        if (n_bytes > bytes_.size() - at_)
            fail("the message is truncated: {} bytes are left, expected {} bytes", bytes_.size() - at_,
                 n_bytes);
        at_ += n_bytes;
        return bytes_.substr(at_ - n_bytes, n_bytes);
    }
    std::size_t count_remaining_bytes() const { return bytes_.size() - at_; }

private:
    std::string_view bytes_;
    std::size_t at_ = 0, widest_ = 8;
    bool is_ros1_ = false, swapped_ = false;

    void skip_alignment_padding(std::size_t alignment_bytes) {
        const std::size_t beyond = at_ % alignment_bytes;
        if (beyond != 0) read_bytes(alignment_bytes - beyond);
    }
};

}  // namespace relidar::bag
