// SPDX-License-Identifier: Apache-2.0
// Writes MCAP files (mcap.dev/spec). Messages of several channels are written in time
// order, in chunks. An index at the end of the file allows seeking. The caller encodes
// the messages.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::codecs {

class McapWriter {
public:
    using McapMetadataMap = std::map<std::string, std::string>;  ///< Maps names to values.

    McapWriter(std::filesystem::path path, std::string_view profile);

    /// Writes a schema (add_schema) or a channel (add_channel) to the file. All schemas
    /// and channels must be added before the first message.
    /// @return id of the schema or channel
    std::uint16_t add_schema(std::string_view name, std::string_view encoding, std::string_view definition);
    std::uint16_t add_channel(std::uint16_t schema, std::string_view topic, std::string_view encoding,
                              const McapMetadataMap& metadata = {});
    void add_metadata(std::string_view metadata_name, const McapMetadataMap& metadata_values);
    void add_message(std::uint16_t channel_id, std::uint64_t time_ns, std::string_view message);
    void write_chunk();
    void finish();

private:
    struct MessageIndexEntry {
        std::uint64_t time_ns, offset;  ///< Offset of the message in the chunk.
    };
    std::filesystem::path path_;
    std::ofstream file_;
    std::uint64_t written_ = 0;
    std::string schemas_, channels_, chunk_indices_, metadata_indices_;  ///< Records of the summary.
    std::uint16_t n_schemas_ = 0;
    std::uint32_t n_chunks_ = 0, n_metadata_ = 0;
    std::map<std::uint16_t, std::uint64_t> n_messages_;  ///< Number of messages of each channel.
    std::uint64_t first_ns_ = UINT64_MAX, last_ns_ = 0;  ///< First and last time of all messages.

    std::string chunk_;
    std::map<std::uint16_t, std::vector<MessageIndexEntry>> chunk_index_;
    std::uint64_t chunk_first_ns_ = UINT64_MAX, chunk_last_ns_ = 0;

    void append(std::string_view bytes);
    std::string encode_statistics() const;
};

}  // namespace relidar::codecs
