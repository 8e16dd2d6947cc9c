// SPDX-License-Identifier: Apache-2.0
#include "mcap_writer.hpp"

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
/// Codes of MCAP records.
enum Code : std::uint8_t {
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

void append_text(std::string& bytes, std::string_view text) {
    append(bytes, std::uint32_t(text.size()));
    bytes += text;
}

std::string format_pairs(const McapWriter::Values& values) {
    std::string pairs;
    for (const auto& [key, value] : values) append_text(pairs, key), append_text(pairs, value);
    return pairs;
}

std::string encode_record(Code code, std::string_view body) {
    std::string bytes;
    append(bytes, std::uint8_t(code));
    append(bytes, std::uint64_t(body.size()));
    bytes += body;
    return bytes;
}

}  // namespace

McapWriter::McapWriter(std::filesystem::path path, std::string_view profile)
    : path_(std::move(path)), file_(path_, std::ios::binary) {
    put(kMagic);
    std::string header;
    append_text(header, profile);
    append_text(header, "relidar " RELIDAR_VERSION);
    put(encode_record(kHeader, header));
}

void McapWriter::put(std::string_view bytes) {
    errno = 0;
    file_.write(bytes.data(), std::streamsize(bytes.size()));
    if (!file_)
        throw DataError(fmt::format("cannot write '{}': {}", path_.string(),
                                    errno ? std::strerror(errno) : "unknown error"));
    written_ += bytes.size();
}

std::uint16_t McapWriter::add_schema(std::string_view name, std::string_view encoding,
                                     std::string_view definition) {
    std::string body;
    append(body, ++n_schemas_);
    append_text(body, name), append_text(body, encoding), append_text(body, definition);
    schemas_ += encode_record(kSchema, body);
    put(encode_record(kSchema, body));
    return n_schemas_;
}

std::uint16_t McapWriter::add_channel(std::uint16_t schema, std::string_view topic, std::string_view encoding,
                                      const Values& metadata) {
    const auto id = std::uint16_t(n_messages_.size() + 1);
    n_messages_[id] = 0;
    std::string body;
    append(body, id), append(body, schema);
    append_text(body, topic), append_text(body, encoding), append_text(body, format_pairs(metadata));
    channels_ += encode_record(kChannel, body);
    put(encode_record(kChannel, body));
    return id;
}

void McapWriter::add_metadata(std::string_view name, const Values& values) {
    std::string body, index;
    append_text(body, name), append_text(body, format_pairs(values));
    const std::string metadata = encode_record(kMetadata, body);
    append(index, written_), append(index, std::uint64_t(metadata.size())), append_text(index, name);
    metadata_indices_ += encode_record(kMetadataIndex, index);
    ++n_metadata_;
    put(metadata);
}

void McapWriter::add_message(std::uint16_t channel, std::uint64_t time_ns, std::string_view message) {
    chunk_index_[channel].push_back({time_ns, chunk_.size()});
    chunk_first_ns_ = std::min(chunk_first_ns_, time_ns), chunk_last_ns_ = std::max(chunk_last_ns_, time_ns);
    std::string body;
    append(body, channel), append(body, std::uint32_t(n_messages_.at(channel)++));
    // A message has a log time and a publish time. Both get the same value.
    append(body, time_ns), append(body, time_ns);
    body += message;
    chunk_ += encode_record(kMessageRecord, body);
}

void McapWriter::end_chunk() {
    if (chunk_.empty()) return;
    const std::uint64_t begin = written_;
    std::string body;
    append(body, chunk_first_ns_), append(body, chunk_last_ns_), append(body, std::uint64_t(chunk_.size()));
    append(body, std::uint32_t(crc32(0, reinterpret_cast<const Bytef*>(chunk_.data()), uInt(chunk_.size()))));
    // Writes an empty name, which means no compression. Compression would save little,
    // because the floats of a scan compress poorly.
    append_text(body, "");
    append(body, std::uint64_t(chunk_.size()));
    put(encode_record(kChunk, body + chunk_));
    const std::uint64_t end = written_;

    // For each channel, its id and the file position of its message index. The chunk
    // index record contains this list.
    std::string index_positions;
    for (const auto& [channel, messages] : chunk_index_) {
        append(index_positions, channel), append(index_positions, written_);
        std::string index, entries;
        for (const Indexed& message : messages)
            append(entries, message.time_ns), append(entries, message.offset);
        append(index, channel), append_text(index, entries);
        put(encode_record(kMessageIndex, index));
    }
    std::string index;
    append(index, chunk_first_ns_), append(index, chunk_last_ns_), append(index, begin),
        append(index, end - begin);
    append_text(index, index_positions);
    append(index, written_ - end), append_text(index, ""), append(index, std::uint64_t(chunk_.size()));
    append(index, std::uint64_t(chunk_.size()));
    chunk_indices_ += encode_record(kChunkIndex, index);
    ++n_chunks_;
    first_ns_ = std::min(first_ns_, chunk_first_ns_), last_ns_ = std::max(last_ns_, chunk_last_ns_);
    chunk_.clear(), chunk_index_.clear();
    chunk_first_ns_ = UINT64_MAX, chunk_last_ns_ = 0;
}

std::string McapWriter::statistics() const {
    std::string body, counts;
    std::uint64_t n_messages = 0;
    for (const auto& [channel, n] : n_messages_) append(counts, channel), append(counts, n), n_messages += n;
    append(body, n_messages), append(body, n_schemas_), append(body, std::uint32_t(n_messages_.size()));
    // The number of attachments is 0.
    append(body, std::uint32_t(0)), append(body, n_metadata_), append(body, n_chunks_);
    append(body, n_messages ? first_ns_ : std::uint64_t(0)), append(body, last_ns_);
    append_text(body, counts);
    return encode_record(kStatistics, body);
}

/// Returns the bytes of the summary section at the end of the file. Records with the same
/// code form a group.
/// @param groups receives the position of each group
std::string McapWriter::summary(std::vector<Group>& groups) const {
    std::string bytes;
    const auto add = [&](Code code, const std::string& records) {
        if (!records.empty()) groups.push_back({code, written_ + bytes.size(), records.size()});
        bytes += records;
    };
    add(kSchema, schemas_), add(kChannel, channels_), add(kStatistics, statistics());
    add(kChunkIndex, chunk_indices_), add(kMetadataIndex, metadata_indices_);
    return bytes;
}

void McapWriter::close() {
    end_chunk();
    std::string end, footer;
    // Checksum 0 means that the file has no checksum. Each chunk has one instead.
    append(end, std::uint32_t(0));
    put(encode_record(kDataEnd, end));
    const std::uint64_t begin = written_;
    std::vector<Group> groups;
    put(summary(groups));
    const std::uint64_t offsets = written_;
    for (const Group& group : groups) {
        std::string body;
        append(body, group.code), append(body, group.begin), append(body, group.n_bytes);
        put(encode_record(kSummaryOffset, body));
    }
    append(footer, begin), append(footer, offsets), append(footer, std::uint32_t(0));
    put(encode_record(kFooter, footer));
    put(kMagic);
    file_.close();
    if (!file_) throw DataError(fmt::format("cannot write '{}': the disk is probably full", path_.string()));
}

}  // namespace relidar::scan_files
