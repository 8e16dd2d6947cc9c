// SPDX-License-Identifier: Apache-2.0
// Names of the files of a recording, and positions of messages in them.
#pragma once

#include <compare>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <tuple>

namespace relidar {

/// Removes the extension ".gz", ".zst" or ".zstd", if the path has it.
inline std::filesystem::path strip_packed(const std::filesystem::path& file) {
    const std::filesystem::path ending = file.extension();
    const bool is_packed = ending == ".gz" || ending == ".zst" || ending == ".zstd";
    return is_packed ? std::filesystem::path(file).replace_extension() : file;
}
/// Returns true if a file, which may be compressed, has the extension of a recording.
inline bool is_recording_file(const std::filesystem::path& file) {
    const std::filesystem::path ending = strip_packed(file).extension();
    return ending == ".pcap" || ending == ".pcapng" || ending == ".bag" || ending == ".mcap" ||
           ending == ".db3";
}

/// Position of a message in a recording.
struct MessagePosition {
    static constexpr std::uint64_t kNoChunk = std::numeric_limits<std::uint64_t>::max();

    /// Byte offset of the chunk (block of messages) that contains the message. Without a
    /// chunk, byte offset of the message. In SQLite, the row number of the message.
    std::uint64_t at = 0;
    std::uint64_t in_chunk = kNoChunk;  ///< byte offset of the message's record in the unpacked chunk
    std::uint32_t file = 0;             ///< index of the file in the recording

    bool operator==(const MessagePosition&) const = default;
    /// Compares positions in the order of the recording.
    auto operator<=>(const MessagePosition& other) const {
        return std::tie(file, at, in_chunk) <=> std::tie(other.file, other.at, other.in_chunk);
    }
};

}  // namespace relidar
