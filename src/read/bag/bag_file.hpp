// SPDX-License-Identifier: Apache-2.0
// Reads recordings as a list of messages. Supports MCAP, rosbag2 in SQLite, ROS 1 bags,
// network captures, and folders with several of these files. Does not interpret the
// content of messages.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/base/progress.hpp>

#include "base/bytes.hpp"
#include "read/files/recording.hpp"

namespace relidar::bag {

/// A topic of a bag. Two topics can have the same name but different message types.
struct BagTopic {
    std::string name;
    /// message type without the "/msg/" of ROS 2, for example "sensor_msgs/PointCloud2"
    std::string type;
    std::string encoding;  ///< encoding of the messages, for example "cdr", "ros1" or "protobuf"
};

struct BagMessage {
    std::size_t topic = 0;    ///< index in BagRecording::topics()
    std::int64_t log_ns = 0;  ///< time of recording
    /// Bytes of the message, valid only during the callback. Empty if the caller
    /// requested only the times of this topic.
    std::string_view bytes;
    MessagePosition message_position;
};

/// Filter that returns true for topics whose messages are read completely. For other
/// topics, only the times of the messages are read.
using TopicFilter = std::function<bool(const BagTopic&)>;
using MessageCallback = std::function<void(const BagMessage&)>;

/// The topics of all files of a bag, in the order in which they first occur.
class TopicTable {
public:
    /// Returns the index of a topic in this table. Adds the topic if it is not known.
    std::size_t topic_index(BagTopic topic);
    const std::vector<BagTopic>& topics() const { return topics_; }

private:
    std::vector<BagTopic> topics_;
};

/// One file of a recording.
class BagFile {
public:
    virtual ~BagFile() = default;
    struct ReadCallbacks {
        const TopicFilter& topic_filter;
        const MessageCallback& message_callback;
        std::function<void(const std::string&)> note;  ///< receives problems of the file
        std::function<void(double)> done;  ///< receives the fraction of the file that has been read

        /// Passes on a message, without its bytes if its topic is not requested.
        void pass(const TopicTable& topics, BagMessage message) const {
            if (!topic_filter(topics.topics()[message.topic])) message.bytes = {};
            message_callback(message);
        }
    };
    /// Reads all messages in file order.
    /// @throws DataError with the problem and its byte offset
    virtual void read_messages(TopicTable& topics, const ReadCallbacks& callbacks) = 0;
    /// Reads the bytes of one message. Thread-safe.
    virtual SharedBytes read_message(const MessagePosition& location) const = 0;
    /// If relidar wrote the bag, returns the name of the coordinate frame of its points.
    /// Otherwise returns an empty string. Call read_messages() first.
    virtual std::string points_frame() const { return ""; }

protected:
    /// A message in the index behind a chunk.
    struct IndexEntry {
        std::uint32_t channel;
        std::int64_t log_ns;
        std::uint64_t in_chunk;  ///< see MessagePosition
    };
    /// Topics of the channels (in ROS 1: connections) that a record has described.
    std::map<std::uint32_t, std::size_t> channels_;
    /// Topics in the index at the end of the file. Empty if the file has no index.
    std::map<std::uint32_t, BagTopic> listed_;

    /// Returns the topic of a channel.
    /// @throws DataError if neither an earlier record nor `listed_` describes it
    std::size_t find_topic(std::uint32_t channel, TopicTable& topics);
    /// Passes on the times of a chunk's messages and returns true, if its index shows
    /// that none of its topics is requested. Otherwise returns false.
    bool skip_chunk(std::uint64_t chunk_offset, const std::vector<IndexEntry>& index, TopicTable& topics,
                    const ReadCallbacks& callbacks);

    /// Processes the record at a byte. If it is damaged, throws, or skips it with a note.
    template <class Process>
    static void process_or_skip(const std::string& file, std::uint64_t at, bool skips,
                                const ReadCallbacks& callbacks, const Process& process) {
        try {
            process();
        } catch (const DataError& error) {
            const std::string text =
                fmt::format("{}: the record at byte {} cannot be read: {}", file, at, error.what());
            if (!skips) throw DataError(text + "; use dataset.skip_broken=true to skip it");
            callbacks.note("skipped: " + text);
        }
    }
};

/// @param skip_damaged_chunks  skip damaged chunks with a note, instead of an error
std::unique_ptr<BagFile> open_mcap_file(const std::filesystem::path& file, bool skip_damaged_chunks);
/// @param name  file of the user, of which `file` may be an unpacked copy
std::unique_ptr<BagFile> open_pcap_file(const std::filesystem::path& file, const std::filesystem::path& name);
std::unique_ptr<BagFile> open_ros1_bag(const std::filesystem::path& file, bool skip_damaged_chunks);
std::unique_ptr<BagFile> open_sqlite_bag(const std::filesystem::path& file);

/// A recording that consists of one or several files.
class BagRecording {
public:
    /// Opens a recording: a ROS bag or a network capture.
    /// @param path  a file, or a folder of files with or without metadata.yaml
    /// @throws DataError that names the file
    BagRecording(const std::filesystem::path& path, bool skip_broken);

    /// topics of all messages that were read so far
    const std::vector<BagTopic>& topics() const { return topics_.topics(); }
    const std::vector<std::string>& file_problems() const { return notes_; }
    const std::vector<std::filesystem::path>& file_paths() const { return paths_; }
    std::string points_frame() const;  ///< see BagFile

    /// Reads all messages in the order of the files.
    /// @param filter  topics whose messages are read completely
    void read_messages(const TopicFilter& filter, const MessageCallback& callback,
                       const Progress& progress = {});
    /// Thread-safe.
    SharedBytes read_message(const BagTopic& topic, const MessagePosition& message_position) const;

private:
    std::vector<std::string> notes_;
    std::vector<std::filesystem::path> paths_;
    std::vector<std::unique_ptr<BagFile>> files_;
    TopicTable topics_;

    void add_note_once(const std::string& text);
};

}  // namespace relidar::bag
