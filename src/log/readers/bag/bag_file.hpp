// SPDX-License-Identifier: Apache-2.0
// Reads recordings as a list of messages. Supports MCAP, rosbag2 in SQLite, ROS 1 bags,
// network captures, and folders with several of these files. Does not interpret the
// content of messages.
#pragma once

#include <compare>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/base/progress.hpp>

#include "base/shared_bytes.hpp"

namespace relidar::bag {

/// A topic of a bag. Two topics can have the same name but different message types.
struct Topic {
    std::string name;
    /// message type without the "/msg/" of ROS 2, for example "sensor_msgs/PointCloud2"
    std::string type;
    std::string encoding;  ///< encoding of the messages, for example "cdr", "ros1" or "protobuf"
};

/// Position of a message in a recording.
struct Place {
    static constexpr std::uint64_t kNoChunk = std::numeric_limits<std::uint64_t>::max();

    /// Byte offset of the chunk that contains the message, or of the message itself if it
    /// is not in a chunk. In SQLite, the row number of the message.
    std::uint64_t at = 0;
    std::uint64_t in_chunk = kNoChunk;  ///< byte offset of the message's record in the unpacked chunk
    std::uint32_t file = 0;             ///< index of the file in the recording

    auto operator<=>(const Place&) const = default;
};

struct Message {
    std::size_t topic = 0;    ///< index in Bag::topics()
    std::int64_t log_ns = 0;  ///< time of recording
    /// Bytes of the message, valid only during the callback. Empty if the caller did not
    /// request the messages of this topic.
    std::string_view bytes;
    Place place;
};

/// Filter that returns true for topics whose messages are read completely. For other
/// topics, only the times of the messages are read.
using Wanted = std::function<bool(const Topic&)>;
using Take = std::function<void(const Message&)>;

/// The topics of all files of a bag, in the order in which they first occur.
class TopicTable {
public:
    std::size_t number_of(Topic topic);
    const std::vector<Topic>& topics() const { return topics_; }

private:
    std::vector<Topic> topics_;
};

/// One file of a recording.
class BagFile {
public:
    virtual ~BagFile() = default;
    /// Callbacks of for_each_message().
    struct Pass {
        const Wanted& wanted;
        const Take& take;
        std::function<void(const std::string&)> note;  ///< receives problems of the file
        std::function<void(double)> done;  ///< receives the fraction of the file that has been read
    };
    /// Reads all messages in file order and passes each one to `pass.take`.
    /// @throws DataError with the problem and its byte offset
    virtual void for_each_message(TopicTable& topics, const Pass& pass) = 0;
    /// Reads the bytes of one message. Thread-safe.
    virtual SharedBytes read(const Place& place) const = 0;
    /// If relidar wrote the bag, returns the name of the coordinate frame of its points.
    /// Otherwise returns an empty string. Call for_each_message() first.
    virtual std::string points_in() const { return ""; }
};

/// Opens an MCAP file.
/// @param skip_broken  if true, damaged chunks are skipped with a note; if false, they
/// cause an error
std::unique_ptr<BagFile> open_mcap(const std::filesystem::path& file, bool skip_broken);
std::unique_ptr<BagFile> open_pcap(const std::filesystem::path& file);
std::unique_ptr<BagFile> open_ros1(const std::filesystem::path& file, bool skip_broken);
/// Opens a rosbag2 file in SQLite format.
/// @param packed  true if each message is compressed with zstd
std::unique_ptr<BagFile> open_sqlite(const std::filesystem::path& file, bool packed);

/// A recording that consists of one or several files.
class Bag {
public:
    /// Opens a recording: a ROS bag or a network capture.
    /// @param path  a file, or a folder of files with or without metadata.yaml
    /// @throws DataError with the file
    Bag(const std::filesystem::path& path, bool skip_broken);

    /// Returns the topics of all messages that were read so far.
    const std::vector<Topic>& topics() const { return topics_.topics(); }
    const std::vector<std::string>& notes() const { return notes_; }  ///< problems of the files
    const std::vector<std::filesystem::path>& files() const { return paths_; }
    /// If relidar wrote the bag, returns the name of the coordinate frame of its points.
    /// Otherwise returns an empty string. Call for_each_message() first.
    std::string points_in() const;

    /// Reads the messages of all files in order and passes each one to `callback`.
    void for_each_message(const Wanted& filter, const Take& callback, const Progress& progress = {});
    /// Reads the bytes of one message. Thread-safe.
    SharedBytes read(const Place& place) const;

private:
    std::vector<std::filesystem::path> paths_;
    std::vector<std::unique_ptr<BagFile>> files_;
    TopicTable topics_;
    std::vector<std::string> notes_;

    void note(const std::string& text);
};

}  // namespace relidar::bag
