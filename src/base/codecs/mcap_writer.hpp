// SPDX-License-Identifier: Apache-2.0
// The container format MCAP (mcap.dev/spec): messages of several channels in order of
// time, in chunks, with an index at the end, so that a reader can seek. What messages
// hold is the caller's business.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::scan_files {

/// Writes one file, piece by piece.
class McapWriter {
public:
    using Values = std::map<std::string, std::string>;  ///< by name

    /// @param profile  "ros2" where messages are ROS 2's, else empty @throws DataError as
    /// all that write
    McapWriter(std::filesystem::path path, std::string_view profile);

    /// Schemas and channels come before all messages. @return the id
    std::uint16_t add_schema(std::string_view name, std::string_view encoding, std::string_view definition);
    std::uint16_t add_channel(std::uint16_t schema, std::string_view topic, std::string_view encoding,
                              const Values& metadata = {});
    void add_metadata(std::string_view name, const Values& values);
    void add_message(std::uint16_t channel, std::uint64_t time_ns, std::string_view message);
    /// Ends the chunk of the messages since the last one: a reader loads it as a whole.
    void end_chunk();
    /// Writes what a reader looks for first. Nothing may follow.
    void close();

private:
    struct Indexed {
        std::uint64_t time_ns, offset;  ///< in the chunk
    };
    struct Group {
        std::uint8_t code;             ///< of its records
        std::uint64_t begin, n_bytes;  ///< in the file
    };

    std::filesystem::path path_;
    std::ofstream file_;
    std::uint64_t written_ = 0;
    std::string schemas_, channels_, chunk_indices_, metadata_indices_;  ///< records of the summary
    std::uint16_t n_schemas_ = 0;
    std::uint32_t n_chunks_ = 0, n_metadata_ = 0;
    std::map<std::uint16_t, std::uint64_t> n_messages_;  ///< of each channel
    std::uint64_t first_ns_ = UINT64_MAX, last_ns_ = 0;  ///< of all messages

    std::string chunk_;
    std::map<std::uint16_t, std::vector<Indexed>> chunk_index_;
    std::uint64_t chunk_first_ns_ = UINT64_MAX, chunk_last_ns_ = 0;

    void put(std::string_view bytes);
    std::string statistics() const;
    std::string summary(std::vector<Group>& groups) const;
};

}  // namespace relidar::scan_files
