// SPDX-License-Identifier: Apache-2.0
// Reads ROS 1 bags of format 2.0 (wiki.ros.org/Bags/Format/2.0). A record consists of a
// header with named values, and data. A length of 4 bytes precedes each of these two
// parts. Reads the records one after another, so a bag without an index can also be read.
// With an index, skips the chunks in which no topic is requested.
#include <map>
#include <optional>
#include <vector>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/bag_file.hpp"
#include "read/bag/part_file.hpp"

namespace relidar::bag {
namespace {

constexpr std::string_view kRos1Magic = "#ROSBAG V2.0\n";
constexpr std::uint32_t kLongestHeader = 1 << 20;
constexpr std::uint64_t kLengthBytes = 4;
enum Ros1Op : std::uint8_t {
    kRos1Message = 2,
    kRos1BagHeader = 3,
    kRos1Index = 4,
    kRos1Chunk = 5,
    kRos1Connection = 7
};

std::int64_t read_ros1_time(codecs::ByteReader& reader) {
    const auto seconds = reader.read_number<std::uint32_t>(),
               nanoseconds = reader.read_number<std::uint32_t>();
    return std::int64_t(seconds) * 1000000000 + nanoseconds;
}

/// The named values in the header of a record.
class Ros1Header {
public:
    /// A field is a string "name=value" with its length in front.
    explicit Ros1Header(std::string_view bytes) {
        codecs::ByteReader reader(bytes);
        while (reader.remaining() > 0) {
            const std::string_view field = reader.read_string();
            const std::size_t equals = field.find('=');
            if (equals == std::string_view::npos)
                fail("found the header field '{}', expected name=value", quote(field));
            values_[field.substr(0, equals)] = field.substr(equals + 1);
        }
    }
    std::string_view text_field(std::string_view field_name) const {
        const auto at = values_.find(field_name);
        if (at == values_.end()) fail("the header has no field '{}'", field_name);
        return at->second;
    }
    template <class T>
    T number_field(std::string_view field_name) const {
        return codecs::ByteReader(text_field(field_name)).read_number<T>();
    }

private:
    std::map<std::string_view, std::string_view> values_;
};

struct Ros1Record {
    std::string_view header, data;
};

Ros1Record read_ros1_record(codecs::ByteReader& reader) {
    const std::string_view header = reader.read_string();
    return {header, reader.read_string()};
}

/// A ROS 1 bag. Each message belongs to a connection, which defines its topic and type.
class Ros1File : public BagFile {
public:
    Ros1File(const std::filesystem::path& path, bool skip_broken) : file_(path), skip_broken_(skip_broken) {
        if (file_.size() < kRos1Magic.size() || file_.read_bytes_at(0, kRos1Magic.size()).bytes != kRos1Magic)
            fail("{}: the file does not begin like a ROS 1 bag of format 2.0", file_.name());
    }

    void read_messages(TopicTable& topics, const ReadCallbacks& callbacks) override {
        channels_.clear();
        read_listed();
        std::uint64_t at = kRos1Magic.size();
        while (at < file_.size()) {
            const std::optional<Ros1RecordExtent> record = read_extent(at);
            if (!record) {
                callbacks.note(
                    fmt::format("{}: the file is truncated at byte {} of {}; later messages are missing",
                                file_.name(), at, file_.size()));
                return;
            }
            callbacks.done(double(at) / double(file_.size()));
            process_or_skip(file_.name(), at, skip_broken_, callbacks,
                            [&] { process_at(at, *record, topics, callbacks); });
            at = record->data_at + record->data_bytes;
        }
    }

    SharedBytes read_message(const MessagePosition& place) const override {
        if (place.in_chunk == MessagePosition::kNoChunk) {
            const std::optional<Ros1RecordExtent> record = read_extent(place.at);
            if (!record) fail("{}: the message at byte {} is truncated", file_.name(), place.at);
            return file_.read_bytes_at(record->data_at, record->data_bytes);
        }
        const SharedBytes records =
            chunks_.find_or_unpack(place.at, [&] { return read_chunk(*read_extent(place.at)); });
        codecs::ByteReader reader(records.bytes.substr(std::size_t(place.in_chunk)));
        return records.share_part(read_ros1_record(reader).data);
    }

private:
    struct Ros1RecordExtent {
        SharedBytes header;
        std::uint64_t data_at = 0;
        std::uint32_t data_bytes = 0;
    };

    RandomAccessFile file_;
    const bool skip_broken_;
    ChunkCache chunks_;

    /// Reads the connections that follow the last chunk. Ignores a missing or damaged
    /// index.
    void read_listed() {
        listed_.clear();
        try {
            const auto bag = read_extent(kRos1Magic.size());
            if (!bag || Ros1Header(bag->header.bytes).number_field<std::uint8_t>("op") != kRos1BagHeader)
                return;
            std::uint64_t at = Ros1Header(bag->header.bytes).number_field<std::uint64_t>("index_pos");
            for (auto record = read_extent(at); at != 0 && record; record = read_extent(at)) {
                const Ros1Header header(record->header.bytes);
                if (header.number_field<std::uint8_t>("op") != kRos1Connection) return;
                const SharedBytes data = file_.read_bytes_at(record->data_at, record->data_bytes);
                listed_[header.number_field<std::uint32_t>("conn")] = parse_topic(header, data.bytes);
                at = record->data_at + record->data_bytes;
            }
        } catch (const DataError&) {
            listed_.clear();
        }
    }

    /// @param data  header with the message type
    static BagTopic parse_topic(const Ros1Header& header, std::string_view data) {
        return {std::string(header.text_field("topic")), std::string(Ros1Header(data).text_field("type")),
                "ros1"};
    }

    /// Reads the index behind a chunk. Returns an empty list if the index is missing,
    /// damaged or incomplete.
    std::vector<IndexEntry> read_chunk_index(std::uint64_t chunk_end) const {
        std::vector<IndexEntry> entries;
        try {
            for (auto record = read_extent(chunk_end); record;
                 record = read_extent(record->data_at + record->data_bytes)) {
                const Ros1Header header(record->header.bytes);
                if (header.number_field<std::uint8_t>("op") != kRos1Index) break;
                if (record->data_bytes == 0) return {};
                const auto connection = header.number_field<std::uint32_t>("conn");
                const SharedBytes data = file_.read_bytes_at(record->data_at, record->data_bytes);
                for (codecs::ByteReader list(data.bytes); list.remaining() > 0;) {
                    const std::int64_t log_ns = read_ros1_time(list);
                    entries.push_back({connection, log_ns, list.read_number<std::uint32_t>()});
                }
            }
        } catch (const DataError&) {
            return {};
        }
        return entries;
    }

    /// Returns the header of a record and the position of its data. Returns nothing if
    /// the file ends within the record.
    std::optional<Ros1RecordExtent> read_extent(std::uint64_t record_offset) const {
        // Header and data are preceded by their lengths.
        const auto length_at = [&](std::uint64_t at) -> std::optional<std::uint32_t> {
            if (at > file_.size() || file_.size() - at < kLengthBytes) return std::nullopt;
            const SharedBytes bytes = file_.read_bytes_at(at, kLengthBytes);
            const auto length = codecs::ByteReader(bytes.bytes).read_number<std::uint32_t>();
            const bool is_complete = length <= file_.size() - at - kLengthBytes;
            return is_complete ? std::optional(length) : std::nullopt;
        };
        const auto header_bytes = length_at(record_offset);
        if (!header_bytes) return std::nullopt;
        if (*header_bytes > kLongestHeader)
            fail("{}: the record at byte {} has a header of {} bytes, expected at most {}", file_.name(),
                 record_offset, *header_bytes, kLongestHeader);
        const std::uint64_t header_at = record_offset + kLengthBytes;
        const auto data_bytes = length_at(header_at + *header_bytes);
        if (!data_bytes) return std::nullopt;
        return Ros1RecordExtent{.header = file_.read_bytes_at(header_at, *header_bytes),
                                .data_at = header_at + *header_bytes + kLengthBytes,
                                .data_bytes = *data_bytes};
    }

    /// Reads and unpacks the records of a chunk.
    SharedBytes read_chunk(const Ros1RecordExtent& chunk_extent) const {
        const Ros1Header header(chunk_extent.header.bytes);
        return unpack_chunk(header.text_field("compression"),
                            file_.read_bytes_at(chunk_extent.data_at, chunk_extent.data_bytes),
                            header.number_field<std::uint32_t>("size"));
    }

    /// Processes the record at a byte of the file. A chunk contains further records.
    void process_at(std::uint64_t record_offset, const Ros1RecordExtent& record_extent, TopicTable& topics,
                    const ReadCallbacks& callbacks) {
        const Ros1Header header(record_extent.header.bytes);
        const auto op = header.number_field<std::uint8_t>("op");
        if (op == kRos1Chunk) {
            const std::uint64_t chunk_end = record_extent.data_at + record_extent.data_bytes;
            if (skip_chunk(record_offset, read_chunk_index(chunk_end), topics, callbacks)) return;
            const SharedBytes records = read_chunk(record_extent);
            codecs::ByteReader reader(records.bytes);
            while (reader.remaining() > 0) {
                const std::uint64_t in_chunk = reader.position();
                const Ros1Record part = read_ros1_record(reader);
                process_record(Ros1Header(part.header), part.data, {record_offset, in_chunk}, topics,
                               callbacks);
            }
        } else if (op == kRos1Connection || op == kRos1Message) {
            process_record(header, file_.read_bytes_at(record_extent.data_at, record_extent.data_bytes).bytes,
                           {record_offset, MessagePosition::kNoChunk}, topics, callbacks);
        }
    }

    /// Stores the connection of a record, or passes on its message.
    void process_record(const Ros1Header& record_header, std::string_view record_data,
                        const MessagePosition& message_position, TopicTable& topics,
                        const ReadCallbacks& callbacks) {
        const auto op = record_header.number_field<std::uint8_t>("op");
        if (op != kRos1Connection && op != kRos1Message) return;
        const auto id = record_header.number_field<std::uint32_t>("conn");
        if (op == kRos1Connection) {
            channels_[id] = topics.topic_index(parse_topic(record_header, record_data));
            return;
        }
        codecs::ByteReader time(record_header.text_field("time"));
        callbacks.pass(topics, {find_topic(id, topics), read_ros1_time(time), record_data, message_position});
    }
};

}  // namespace

std::unique_ptr<BagFile> open_ros1_bag(const std::filesystem::path& file, bool skip_damaged_chunks) {
    return std::make_unique<Ros1File>(file, skip_damaged_chunks);
}

}  // namespace relidar::bag
