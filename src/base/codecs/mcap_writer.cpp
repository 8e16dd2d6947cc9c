// SPDX-License-Identifier: Apache-2.0
#include "mcap_writer.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstring>

#include <zlib.h>
#include <zstd.h>

#include "base/bytes.hpp"

namespace relidar::codecs {
namespace {

static_assert(std::endian::native == std::endian::little, "MCAP is little-endian");

constexpr std::string_view kMagic("\x89MCAP0\r\n", 8);
using McapRecordCode = std::uint8_t;
constexpr McapRecordCode kHeader = 1, kFooter = 2, kSchema = 3, kChannel = 4, kMessageRecord = 5, kChunk = 6,
                         kMessageIndex = 7, kChunkIndex = 8, kStatistics = 11, kMetadata = 12,
                         kMetadataIndex = 13, kSummaryOffset = 14, kDataEnd = 15;

void append_value(std::string& bytes, std::string_view text) {
    append_raw(bytes, std::uint32_t(text.size()));
    bytes += text;
}

template <class T>
requires std::is_arithmetic_v<T>
void append_value(std::string& bytes, T number) { append_raw(bytes, number); }

/// Returns the bytes of numbers, and of texts with their length before them.
template <class... T>
std::string encode(const T&... values) {
    std::string bytes;
    (append_value(bytes, values), ...);
    return bytes;
}

std::string encode_map(const McapWriter::McapMetadataMap& values) {
    std::string pairs;
    for (const auto& [key, value] : values) pairs += encode(key, value);
    return pairs;
}

std::string encode_record(McapRecordCode record_code, std::string_view body) {
    return encode(record_code, std::uint64_t(body.size())).append(body);
}

std::string compress(const std::string& bytes) {
    std::string packed(ZSTD_compressBound(bytes.size()), '\0');
    const std::size_t size =
        ZSTD_compress(packed.data(), packed.size(), bytes.data(), bytes.size(), ZSTD_CLEVEL_DEFAULT);
    if (ZSTD_isError(size)) fail("cannot compress {} bytes: {}", bytes.size(), ZSTD_getErrorName(size));
    packed.resize(size);
    return packed;
}

}  // namespace

McapWriter::McapWriter(std::filesystem::path path, std::string_view profile)
    : path_(std::move(path)), file_(path_, std::ios::binary) {
    append(kMagic);
    append(encode_record(kHeader, encode(profile, "relidar " RELIDAR_VERSION)));
}

void McapWriter::append(std::string_view bytes) {
    errno = 0;
    file_.write(bytes.data(), std::streamsize(bytes.size()));
    if (!file_) fail("cannot write '{}': {}", path_.string(), errno ? std::strerror(errno) : "unknown error");
    written_ += bytes.size();
}

std::uint16_t McapWriter::add_schema(std::string_view name, std::string_view encoding,
                                     std::string_view definition) {
    const std::string schema = encode_record(kSchema, encode(++n_schemas_, name, encoding, definition));
    schemas_ += schema;
    append(schema);
    return n_schemas_;
}

/// Writes a channel, which has one topic and messages of one schema. Returns its id.
std::uint16_t McapWriter::add_channel(std::uint16_t schema, std::string_view topic, std::string_view encoding,
                                      const McapMetadataMap& metadata) {
    const auto id = std::uint16_t(n_messages_.size() + 1);
    n_messages_[id] = 0;
    const std::string channel =
        encode_record(kChannel, encode(id, schema, topic, encoding, encode_map(metadata)));
    // The summary at the end of the file repeats all channels.
    channels_ += channel;
    append(channel);
    return id;
}

void McapWriter::add_metadata(std::string_view metadata_name, const McapMetadataMap& metadata_values) {
    const std::string metadata = encode_record(kMetadata, encode(metadata_name, encode_map(metadata_values)));
    metadata_indices_ +=
        encode_record(kMetadataIndex, encode(written_, std::uint64_t(metadata.size()), metadata_name));
    ++n_metadata_;
    append(metadata);
}

void McapWriter::add_message(std::uint16_t channel_id, std::uint64_t time_ns, std::string_view message) {
    chunk_index_[channel_id].push_back({time_ns, chunk_.size()});
    chunk_first_ns_ = std::min(chunk_first_ns_, time_ns);
    chunk_last_ns_ = std::max(chunk_last_ns_, time_ns);
    // A message has a log time and a publish time. Both get the same value.
    chunk_ += encode_record(
        kMessageRecord,
        encode(channel_id, std::uint32_t(n_messages_.at(channel_id)++), time_ns, time_ns).append(message));
}

/// Writes the messages since the last call as a chunk, then for each channel an index
/// with the time and the position of each of its messages. A record of the summary, which
/// finish() writes, has the positions of the chunk and its indices.
void McapWriter::write_chunk() {
    if (chunk_.empty()) return;
    const std::uint64_t chunk_begin = written_, n_bytes = chunk_.size();
    const auto crc = std::uint32_t(crc32(0, reinterpret_cast<const Bytef*>(chunk_.data()), uInt(n_bytes)));
    const std::string packed = compress(chunk_);
    const std::uint64_t n_packed = packed.size();
    constexpr std::string_view kCompression = "zstd";
    // First and last time, size, checksum, compression, stored size, messages.
    append(encode_record(
        kChunk, encode(chunk_first_ns_, chunk_last_ns_, n_bytes, crc, kCompression, n_packed) + packed));
    const std::uint64_t chunk_end = written_;

    // List of channel ids, each with the file position of the channel's message index.
    // The chunk index record contains this list.
    std::string index_positions;
    for (const auto& [channel, messages] : chunk_index_) {
        index_positions += encode(channel, written_);
        std::string entries;
        for (const MessageIndexEntry& message : messages) entries += encode(message.time_ns, message.offset);
        append(encode_record(kMessageIndex, encode(channel, entries)));
    }
    const std::uint64_t index_bytes = written_ - chunk_end;
    chunk_indices_ += encode_record(
        kChunkIndex, encode(chunk_first_ns_, chunk_last_ns_, chunk_begin, chunk_end - chunk_begin,
                            index_positions, index_bytes, kCompression, n_packed, n_bytes));
    ++n_chunks_;
    first_ns_ = std::min(first_ns_, chunk_first_ns_);
    last_ns_ = std::max(last_ns_, chunk_last_ns_);
    chunk_.clear();
    chunk_index_.clear();
    chunk_first_ns_ = UINT64_MAX;
    chunk_last_ns_ = 0;
}

/// Encodes the statistics record of the summary: numbers of messages, schemas, channels,
/// attachments, metadata and chunks, first and last time, and messages of each channel.
std::string McapWriter::encode_statistics() const {
    std::string counts;
    std::uint64_t n_messages = 0;
    for (const auto& [channel, n] : n_messages_) {
        counts += encode(channel, n);
        n_messages += n;
    }
    const std::uint32_t n_attachments = 0;
    const std::uint64_t first_ns = n_messages ? first_ns_ : 0;  // both times are 0 without messages
    return encode_record(kStatistics,
                         encode(n_messages, n_schemas_, std::uint32_t(n_messages_.size()), n_attachments,
                                n_metadata_, n_chunks_, first_ns, last_ns_, counts));
}

/// Writes the last chunk and the end of the file: summary, positions in it, and footer.
/// The summary repeats schemas and channels, and lists the chunks for seeking.
void McapWriter::finish() {
    write_chunk();
    // Checksum 0 means that the file has no checksum. Each chunk has one instead.
    const std::uint32_t no_checksum = 0;
    append(encode_record(kDataEnd, encode(no_checksum)));
    // Records with the same code form a group, whose positions follow the summary.
    const std::uint64_t summary_begin = written_;
    std::string group_positions;
    for (const auto& [code, records] : {std::pair(kSchema, schemas_),
                                        {kChannel, channels_},
                                        {kStatistics, encode_statistics()},
                                        {kChunkIndex, chunk_indices_},
                                        {kMetadataIndex, metadata_indices_}}) {
        if (records.empty()) continue;
        group_positions +=
            encode_record(kSummaryOffset, encode(code, written_, std::uint64_t(records.size())));
        append(records);
    }
    const std::uint64_t positions_begin = written_;
    append(group_positions);
    append(encode_record(kFooter, encode(summary_begin, positions_begin, no_checksum)));
    append(kMagic);
    file_.close();
    if (!file_) fail("cannot write '{}': the disk is probably full", path_.string());
}

}  // namespace relidar::codecs
