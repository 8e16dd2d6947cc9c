// SPDX-License-Identifier: Apache-2.0
// Reads ROS 1 bags of format 2.0 (wiki.ros.org/Bags/Format/2.0). A record consists of a
// header with named values, and data. A length of 4 bytes precedes each of these two
// parts. Reads the records one after another, so a bag without an index can also be read.
#include <map>
#include <optional>

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
enum Ros1Op : std::uint8_t { kRos1Message = 2, kRos1Chunk = 5, kRos1Connection = 7 };

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
        connections_.clear();
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
    std::map<std::uint32_t, std::size_t> connections_;  ///< topic of each connection

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
        // The data of a connection is a header with the message type.
        if (op == kRos1Connection) {
            const Ros1Header connection(record_data);
            connections_[id] = topics.topic_index({std::string(record_header.text_field("topic")),
                                                   std::string(connection.text_field("type")), "ros1"});
            return;
        }
        const auto connection = connections_.find(id);
        if (connection == connections_.end())
            fail("a message belongs to connection {}, but no earlier record describes this connection", id);
        codecs::ByteReader time(record_header.text_field("time"));
        const auto seconds = time.read_number<std::uint32_t>(),
                   nanoseconds = time.read_number<std::uint32_t>();
        callbacks.pass(topics, {connection->second, std::int64_t(seconds) * 1000000000 + nanoseconds,
                                record_data, message_position});
    }
};

}  // namespace

std::unique_ptr<BagFile> open_ros1_bag(const std::filesystem::path& file, bool skip_damaged_chunks) {
    return std::make_unique<Ros1File>(file, skip_damaged_chunks);
}

}  // namespace relidar::bag
