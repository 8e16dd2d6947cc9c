// SPDX-License-Identifier: Apache-2.0
#include "mcap_writer.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>

#include <fmt/format.h>
#include <zlib.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"

namespace relidar::scan_files {
namespace {

static_assert(std::endian::native == std::endian::little, "MCAP is little-endian");

constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
enum McapRecordCode : std::uint8_t {
    kHeader = 1,
    kFooter = 2,
    kSchema = 3,
    kChannel = 4,
    kMessageRecord = 5,
    kChunk = 6,
    kMessageIndex = 7,
    kChunkIndex = 8,
    kStatistics = 11,
    kMetadata = 12,
    kMetadataIndex = 13,
    kSummaryOffset = 14,
    kDataEnd = 15
};

void append_length_prefixed_text(std::string& bytes, std::string_view text) {
    append_binary_value(bytes, std::uint32_t(text.size()));
    bytes += text;
}

std::string encode_key_value_pairs(const McapWriter::McapMetadataMap& values) {
    std::string pairs;
    for (const auto& [key, value] : values) {
        append_length_prefixed_text(pairs, key);
        append_length_prefixed_text(pairs, value);
    }
    return pairs;
}

std::string encode_mcap_record(McapRecordCode record_code, std::string_view body) {
    std::string bytes;
    append_binary_value(bytes, std::uint8_t(record_code));
    append_binary_value(bytes, std::uint64_t(body.size()));
    bytes += body;
    return bytes;
}

}  // namespace

McapWriter::McapWriter(std::filesystem::path path, std::string_view profile)
    : path_(std::move(path)), file_(path_, std::ios::binary) {
    append_to_mcap_file(kMagic);
    std::string header;
    append_length_prefixed_text(header, profile);
    append_length_prefixed_text(header, "relidar " RELIDAR_VERSION);
    append_to_mcap_file(encode_mcap_record(kHeader, header));
}

void McapWriter::append_to_mcap_file(std::string_view bytes) {
    errno = 0;
    file_.write(bytes.data(), std::streamsize(bytes.size()));
    if (!file_) fail("cannot write '{}': {}", path_.string(), errno ? std::strerror(errno) : "unknown error");
    written_ += bytes.size();
}

std::uint16_t McapWriter::add_schema(std::string_view schema_name, std::string_view encoding,
                                     std::string_view definition) {
    std::string body;
    append_binary_value(body, ++n_schemas_);
    append_length_prefixed_text(body, schema_name);
    append_length_prefixed_text(body, encoding);
    append_length_prefixed_text(body, definition);
    schemas_ += encode_mcap_record(kSchema, body);
    append_to_mcap_file(encode_mcap_record(kSchema, body));
    return n_schemas_;
}

std::uint16_t McapWriter::add_channel(std::uint16_t schema, std::string_view topic, std::string_view encoding,
                                      const McapMetadataMap& metadata) {
    const auto id = std::uint16_t(n_messages_.size() + 1);
    n_messages_[id] = 0;
    std::string body;
    append_binary_value(body, id);
    append_binary_value(body, schema);
    append_length_prefixed_text(body, topic);
    append_length_prefixed_text(body, encoding);
    append_length_prefixed_text(body, encode_key_value_pairs(metadata));
    channels_ += encode_mcap_record(kChannel, body);
    append_to_mcap_file(encode_mcap_record(kChannel, body));
    return id;
}

void McapWriter::add_metadata(std::string_view metadata_name, const McapMetadataMap& metadata_values) {
    std::string body, index;
    append_length_prefixed_text(body, metadata_name);
    append_length_prefixed_text(body, encode_key_value_pairs(metadata_values));
    const std::string metadata = encode_mcap_record(kMetadata, body);
    append_binary_value(index, written_);
    append_binary_value(index, std::uint64_t(metadata.size()));
    append_length_prefixed_text(index, metadata_name);
    metadata_indices_ += encode_mcap_record(kMetadataIndex, index);
    ++n_metadata_;
    append_to_mcap_file(metadata);
}

void McapWriter::add_message(std::uint16_t channel_id, std::uint64_t time_ns, std::string_view message) {
    chunk_index_[channel_id].push_back({time_ns, chunk_.size()});
    chunk_first_ns_ = std::min(chunk_first_ns_, time_ns);
    chunk_last_ns_ = std::max(chunk_last_ns_, time_ns);
    std::string body;
    append_binary_value(body, channel_id);
    append_binary_value(body, std::uint32_t(n_messages_.at(channel_id)++));
    // A message has a log time and a publish time. Both get the same value.
    append_binary_value(body, time_ns);
    append_binary_value(body, time_ns);
    body += message;
    chunk_ += encode_mcap_record(kMessageRecord, body);
}

void McapWriter::write_pending_chunk() {
    if (chunk_.empty()) return;
    const std::uint64_t begin = written_;
    std::string body;
    append_binary_value(body, chunk_first_ns_);
    append_binary_value(body, chunk_last_ns_);
    append_binary_value(body, std::uint64_t(chunk_.size()));
    append_binary_value(
        body, std::uint32_t(crc32(0, reinterpret_cast<const Bytef*>(chunk_.data()), uInt(chunk_.size()))));
    // Writes an empty name, which means no compression. Compression would save little,
    // because the floats of a scan compress poorly.
    append_length_prefixed_text(body, "");
    append_binary_value(body, std::uint64_t(chunk_.size()));
    append_to_mcap_file(encode_mcap_record(kChunk, body + chunk_));
    const std::uint64_t end = written_;

    // List of channel ids, each with the file position of the channel's message index.
    // The chunk index record contains this list.
    std::string index_positions;
    for (const auto& [channel, messages] : chunk_index_) {
        append_binary_value(index_positions, channel);
        append_binary_value(index_positions, written_);
        std::string index, entries;
        for (const MessageIndexEntry& message : messages) {
            append_binary_value(entries, message.time_ns);
            append_binary_value(entries, message.offset);
        }
        append_binary_value(index, channel);
        append_length_prefixed_text(index, entries);
        append_to_mcap_file(encode_mcap_record(kMessageIndex, index));
    }
    std::string index;
    append_binary_value(index, chunk_first_ns_);
    append_binary_value(index, chunk_last_ns_);
    append_binary_value(index, begin);
    append_binary_value(index, end - begin);
    append_length_prefixed_text(index, index_positions);
    append_binary_value(index, written_ - end);
    append_length_prefixed_text(index, "");
    append_binary_value(index, std::uint64_t(chunk_.size()));
    append_binary_value(index, std::uint64_t(chunk_.size()));
    chunk_indices_ += encode_mcap_record(kChunkIndex, index);
    ++n_chunks_;
    first_ns_ = std::min(first_ns_, chunk_first_ns_);
    last_ns_ = std::max(last_ns_, chunk_last_ns_);
    chunk_.clear();
    chunk_index_.clear();
    chunk_first_ns_ = UINT64_MAX;
    chunk_last_ns_ = 0;
}

std::string McapWriter::encode_statistics_record() const {
    std::string body, counts;
    std::uint64_t n_messages = 0;
    for (const auto& [channel, n] : n_messages_) {
        append_binary_value(counts, channel);
        append_binary_value(counts, n);
        n_messages += n;
    }
    append_binary_value(body, n_messages);
    append_binary_value(body, n_schemas_);
    append_binary_value(body, std::uint32_t(n_messages_.size()));
    append_binary_value(body, std::uint32_t(0));
    append_binary_value(body, n_metadata_);
    append_binary_value(body, n_chunks_);
    append_binary_value(body, n_messages ? first_ns_ : std::uint64_t(0));
    append_binary_value(body, last_ns_);
    append_length_prefixed_text(body, counts);
    return encode_mcap_record(kStatistics, body);
}

/// The section at the end of the file. Records with the same code form a group.
/// @param record_groups receives the position of each group
std::string McapWriter::encode_summary_and_list_groups(std::vector<SummaryRecordGroup>& record_groups) const {
    std::string bytes;
    const auto add = [&](McapRecordCode code, const std::string& records) {
        if (!records.empty()) record_groups.push_back({code, written_ + bytes.size(), records.size()});
        bytes += records;
    };
    add(kSchema, schemas_);
    add(kChannel, channels_);
    add(kStatistics, encode_statistics_record());
    add(kChunkIndex, chunk_indices_);
    add(kMetadataIndex, metadata_indices_);
    return bytes;
}

void McapWriter::write_summary_and_close() {
    write_pending_chunk();
    std::string end, footer;
    // Checksum 0 means that the file has no checksum. Each chunk has one instead.
    append_binary_value(end, std::uint32_t(0));
    append_to_mcap_file(encode_mcap_record(kDataEnd, end));
    const std::uint64_t begin = written_;
    std::vector<SummaryRecordGroup> groups;
    append_to_mcap_file(encode_summary_and_list_groups(groups));
    const std::uint64_t offsets = written_;
    for (const SummaryRecordGroup& group : groups) {
        std::string body;
        append_binary_value(body, group.code);
        append_binary_value(body, group.begin);
        append_binary_value(body, group.n_bytes);
        append_to_mcap_file(encode_mcap_record(kSummaryOffset, body));
    }
    append_binary_value(footer, begin);
    append_binary_value(footer, offsets);
    append_binary_value(footer, std::uint32_t(0));
    append_to_mcap_file(encode_mcap_record(kFooter, footer));
    append_to_mcap_file(kMagic);
    file_.close();
    if (!file_) fail("cannot write '{}': the disk is probably full", path_.string());
}

}  // namespace relidar::scan_files
