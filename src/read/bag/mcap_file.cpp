// SPDX-License-Identifier: Apache-2.0
// Reads MCAP files (mcap.dev/spec). A record consists of a code, a length of 8 bytes, and
// a body. Reads the records one after another, so files without index, summary or footer
// can be read too. Does not read messages of topics that are not requested, except those
// in chunks with other topics or without an index.
#include <algorithm>
#include <array>
#include <map>

#include <zlib.h>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "read/bag/bag_file.hpp"
#include "read/bag/part_file.hpp"

namespace relidar::bag {
namespace {

constexpr std::string_view kMcapMagic("\x89MCAP0\r\n", 8);
constexpr std::size_t kRecordHead = 9;  // number of bytes of a record's code and length
// Bytes of a message record before the message, and of a footer.
constexpr std::size_t kMessageHead = 22, kFooterBytes = 20;
constexpr std::size_t kMinSkippedBytes = 4096;  // to skip a shorter message is not faster
enum McapCode : std::uint8_t {
    kMcapFooter = 2,
    kMcapSchema = 3,
    kMcapChannel = 4,
    kMcapMessage = 5,
    kMcapChunk = 6,
    kMcapMessageIndex = 7,
    kMcapMetadata = 12,
    kMcapDataEnd = 15
};

struct McapRecord {
    std::uint8_t code;
    std::string_view body;
};

McapRecord read_mcap_record(codecs::ByteReader& reader) {
    const auto code = reader.read_number<std::uint8_t>();
    return {code, reader.read_bytes(reader.read_number<std::uint64_t>())};
}

struct McapMessage {
    std::uint16_t channel;
    std::int64_t log_ns;
    std::string_view bytes;
};

McapMessage parse_message(std::string_view record_body) {
    codecs::ByteReader reader(record_body);
    const auto channel = reader.read_number<std::uint16_t>();
    reader.read_number<std::uint32_t>();  // skips the sequence number of the message
    const auto log_ns = reader.read_number<std::uint64_t>();
    reader.read_number<std::uint64_t>();  // skips the publication time
    return {channel, std::int64_t(log_ns), reader.read_rest()};
}

/// Returns the records of a chunk, which may be compressed. A chunk consists of two
/// times, unpacked size, checksum, compression and records.
SharedBytes unpack_mcap_chunk(const SharedBytes& chunk_record_body) {
    codecs::ByteReader reader(chunk_record_body.bytes);
    reader.read_bytes(16);  // skips the times of the first and the last message
    const auto n_unpacked = reader.read_number<std::uint64_t>();
    const auto checksum = reader.read_number<std::uint32_t>();
    const std::string_view compression = reader.read_string();
    const auto n_packed = reader.read_number<std::uint64_t>();
    const SharedBytes packed = chunk_record_body.share_part(reader.read_bytes(n_packed));
    SharedBytes records = unpack_chunk(compression, packed, n_unpacked);
    const auto* bytes = reinterpret_cast<const Bytef*>(records.bytes.data());
    const bool has_checksum = checksum != 0;  // 0: the writer has computed none
    if (has_checksum && crc32_z(0, bytes, records.bytes.size()) != checksum)
        fail("the checksum of the data is wrong, so the data is damaged");
    return records;
}

/// An MCAP file. A message has a channel (topic), which has a schema (message type).
class McapFile : public BagFile {
public:
    McapFile(const std::filesystem::path& path, bool skip_broken) : file_(path), skip_broken_(skip_broken) {
        if (file_.size() < kMcapMagic.size() || file_.read_bytes_at(0, kMcapMagic.size()).bytes != kMcapMagic)
            fail("{}: the file does not begin like an MCAP file", file_.name());
    }

    void read_messages(TopicTable& topics, const ReadCallbacks& callbacks) override {
        schemas_.clear();
        channels_.clear();
        points_in_.clear();
        read_summary();
        std::uint64_t at = kMcapMagic.size();
        for (;;) {
            if (file_.size() - at < kRecordHead) break;
            const RecordHead head = read_head(at);
            // The summary behind the data repeats other records, so it is not read.
            if (head.code == kMcapDataEnd || head.code == kMcapFooter) return;
            if (head.body_bytes > file_.size() - at - kRecordHead) break;
            callbacks.done(double(at) / double(file_.size()));
            process_or_skip(file_.name(), at, skip_broken_, callbacks,
                            [&] { process_at(head.code, at, head.body_bytes, topics, callbacks); });
            at += kRecordHead + head.body_bytes;
        }
        // The end of the data section is missing.
        callbacks.note(fmt::format("{}: the file is truncated at byte {} of {}; later messages are missing",
                                   file_.name(), at, file_.size()));
    }

    SharedBytes read_message(const MessagePosition& message_position) const override {
        if (message_position.in_chunk == MessagePosition::kNoChunk) {
            const SharedBytes body = read_body(message_position.at);
            return body.share_part(parse_message(body.bytes).bytes);
        }
        const SharedBytes records = chunks_.find_or_unpack(
            message_position.at, [&] { return unpack_mcap_chunk(read_body(message_position.at)); });
        codecs::ByteReader reader(records.bytes.substr(std::size_t(message_position.in_chunk)));
        return records.share_part(parse_message(read_mcap_record(reader).body).bytes);
    }

    std::string points_frame() const override { return points_in_; }

private:
    RandomAccessFile file_;
    const bool skip_broken_;
    std::string points_in_;  ///< see points_frame()
    ChunkCache chunks_;
    std::map<std::uint16_t, std::string> schemas_;  ///< message type of each schema

    struct RecordHead {
        std::uint8_t code;
        std::uint64_t body_bytes;
    };
    RecordHead read_head(std::uint64_t record_offset) const {
        const SharedBytes head = file_.read_bytes_at(record_offset, kRecordHead);
        codecs::ByteReader reader(head.bytes);
        const auto code = reader.read_number<std::uint8_t>();
        return {code, reader.read_number<std::uint64_t>()};
    }

    /// Reads the body of the record at a byte.
    SharedBytes read_body(std::uint64_t record_offset) const {
        return file_.read_bytes_at(record_offset + kRecordHead, read_head(record_offset).body_bytes);
    }

    /// Reads the channels in the summary. Ignores a missing or damaged summary.
    void read_summary() {
        listed_.clear();
        const std::uint64_t tail = kRecordHead + kFooterBytes + kMcapMagic.size();
        try {
            const std::uint64_t footer = file_.size() - std::min(tail, file_.size());
            if (read_head(footer).code != kMcapFooter) return;
            const SharedBytes begin = file_.read_bytes_at(footer + kRecordHead, sizeof(std::uint64_t));
            auto at = codecs::ByteReader(begin.bytes).read_number<std::uint64_t>();
            while (at != 0 && at < footer) {
                const RecordHead head = read_head(at);
                if (head.body_bytes > footer - at) fail("the summary is damaged");
                if (head.code == kMcapSchema) read_schema(read_body(at).bytes);
                if (head.code == kMcapChannel) listed_.insert(parse_channel(read_body(at).bytes));
                at += kRecordHead + head.body_bytes;
            }
        } catch (const DataError&) {
            listed_.clear();
        }
    }

    void read_schema(std::string_view body) {
        codecs::ByteReader reader(body);
        const auto id = reader.read_number<std::uint16_t>();
        schemas_[id] = reader.read_string();
    }

    std::pair<std::uint16_t, BagTopic> parse_channel(std::string_view body) const {
        codecs::ByteReader reader(body);
        const auto id = reader.read_number<std::uint16_t>(), schema = reader.read_number<std::uint16_t>();
        const std::string name(reader.read_string()), encoding(reader.read_string());
        const auto type = schemas_.find(schema);
        return {id, {name, type == schemas_.end() ? "" : type->second, encoding}};
    }

    /// Reads the index behind a chunk. Returns an empty list if the index is missing,
    /// damaged or incomplete.
    std::vector<IndexEntry> read_chunk_index(std::uint64_t chunk_end) const {
        std::vector<IndexEntry> entries;
        try {
            for (std::uint64_t at = chunk_end; read_head(at).code == kMcapMessageIndex;) {
                const SharedBytes body = read_body(at);
                at += kRecordHead + body.bytes.size();
                codecs::ByteReader reader(body.bytes);
                const auto channel = reader.read_number<std::uint16_t>();
                codecs::ByteReader list(reader.read_string());
                if (list.remaining() == 0) return {};
                while (list.remaining() > 0) {
                    const auto log_ns = std::int64_t(list.read_number<std::uint64_t>());
                    entries.push_back({channel, log_ns, list.read_number<std::uint64_t>()});
                }
            }
        } catch (const DataError&) {
            return {};
        }
        return entries;
    }

    /// Processes the record at a byte of the file. A chunk contains further records.
    void process_at(std::uint8_t record_code, std::uint64_t record_offset, std::uint64_t body_length,
                    TopicTable& topics, const ReadCallbacks& callbacks) {
        constexpr std::array kReadRecords = {kMcapSchema, kMcapChannel, kMcapMessage, kMcapChunk,
                                             kMcapMetadata};
        if (std::ranges::find(kReadRecords, record_code) == kReadRecords.end()) return;
        const std::uint64_t body_offset = record_offset + kRecordHead;
        if (record_code == kMcapChunk &&
            skip_chunk(record_offset, read_chunk_index(body_offset + body_length), topics, callbacks))
            return;
        // Of a message that is not requested, only its channel and times are read.
        if (record_code == kMcapMessage && body_length > kMinSkippedBytes) {
            const SharedBytes head = file_.read_bytes_at(body_offset, kMessageHead);
            const std::size_t topic = find_topic(parse_message(head.bytes).channel, topics);
            if (!callbacks.topic_filter(topics.topics()[topic])) body_length = kMessageHead;
        }
        SharedBytes body = file_.read_bytes_at(body_offset, body_length);
        if (record_code != kMcapChunk) {
            process_record({record_code, body.bytes}, {record_offset, MessagePosition::kNoChunk}, topics,
                           callbacks);
            return;
        }
        const SharedBytes records = unpack_mcap_chunk(body);
        // Frees the packed bytes, unless `records` shares them.
        body = {};
        codecs::ByteReader reader(records.bytes);
        while (reader.remaining() > 0) {
            const std::uint64_t in_chunk = reader.position();
            process_record(read_mcap_record(reader), {record_offset, in_chunk}, topics, callbacks);
        }
    }

    /// Stores the schema or the channel of a record, or passes on its message.
    void process_record(const McapRecord& record, const MessagePosition& message_position, TopicTable& topics,
                        const ReadCallbacks& callbacks) {
        if (record.code == kMcapSchema) {
            read_schema(record.body);
        } else if (record.code == kMcapChannel) {
            auto [id, topic] = parse_channel(record.body);
            channels_[id] = topics.topic_index(std::move(topic));
        } else if (record.code == kMcapMetadata) {
            codecs::ByteReader reader(record.body);
            // Ignores metadata records that relidar did not write.
            if (reader.read_string() != "relidar") return;
            for (codecs::ByteReader pairs(reader.read_string()); pairs.remaining() > 0;) {
                const std::string_view key = pairs.read_string(), value = pairs.read_string();
                if (key == "points_in") points_in_ = value;
            }
        } else if (record.code == kMcapMessage) {
            const McapMessage message = parse_message(record.body);
            callbacks.pass(topics, {find_topic(message.channel, topics), message.log_ns, message.bytes,
                                    message_position});
        }
    }
};

}  // namespace

std::unique_ptr<BagFile> open_mcap_file(const std::filesystem::path& file, bool skip_damaged_chunks) {
    return std::make_unique<McapFile>(file, skip_damaged_chunks);
}

}  // namespace relidar::bag
