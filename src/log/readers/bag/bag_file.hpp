// SPDX-License-Identifier: Apache-2.0
// Reads recordings as a list of messages. Supports MCAP, rosbag2 in SQLite, ROS 1 bags,
// network captures, and folders with several of these files. The content of messages is
// not interpreted here.
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

/// A topic of a recording. Two topics with the same name but different message types are
/// separate.
struct Topic {
    std::string name;
    std::string type;      ///< "sensor_msgs/PointCloud2": without the "/msg/" of ROS 2
    std::string encoding;  ///< encoding of its messages: "cdr", "ros1", "protobuf" ...
};

/// Position of a message in a recording.
struct Place {
    static constexpr std::uint64_t kNoChunk = std::numeric_limits<std::uint64_t>::max();

    /// Byte offset of the chunk in its file. If the message is not in a chunk, byte
    /// offset of the message's record. For SQLite, the row of the message.
    std::uint64_t at = 0;
    std::uint64_t in_chunk = kNoChunk;  ///< byte offset of the message's record in the unpacked chunk
    std::uint32_t file = 0;             ///< index of the file in the recording

    auto operator<=>(const Place&) const = default;
};

struct Message {
    std::size_t topic = 0;    ///< index in Bag::topics()
    std::int64_t log_ns = 0;  ///< time of recording
    /// Bytes of the message, which are valid only during the callback. Empty if messages
    /// of this topic were not requested.
    std::string_view bytes;
    Place place;
};

/// Returns true if the bytes of a topic's messages are needed. If false, only the times
/// of the messages are reported.
using Wanted = std::function<bool(const Topic&)>;
using Take = std::function<void(const Message&)>;

/// The topics of all files of a recording, in order of appearance.
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
    /// Callbacks of each().
    struct Pass {
        const Wanted& wanted;
        const Take& take;
        std::function<void(const std::string&)> note;  ///< receives problems of the file
        std::function<void(double)> done;              ///< receives the share of the file that has been read
    };
    /// Reads all messages in the order of the file and passes each message to
    /// `pass.take`.
    /// @throws DataError with the problem and its byte offset
    virtual void each(TopicTable& topics, const Pass& pass) = 0;
    /// Reads the bytes of one message at a known position. Any thread can call this
    /// function.
    virtual SharedBytes read(const Place& place) const = 0;
    /// Returns in which frame relidar stored the points, if relidar wrote the recording.
    /// Otherwise returns an empty string. Valid only after each().
    virtual std::string points_in() const { return ""; }
};

/// Opens a recording file of the given format.
/// @param skip_broken  true: damaged chunks are skipped with a note; false: they are
/// errors
std::unique_ptr<BagFile> open_mcap(const std::filesystem::path& file, bool skip_broken);
std::unique_ptr<BagFile> open_pcap(const std::filesystem::path& file);
std::unique_ptr<BagFile> open_ros1(const std::filesystem::path& file, bool skip_broken);
/// Opens a rosbag2 database in SQLite.
/// @param packed  true: each message is compressed with zstd
std::unique_ptr<BagFile> open_sqlite(const std::filesystem::path& file, bool packed);

/// A recording of one or several files.
class Bag {
public:
    /// Opens a recording.
    /// @param path  a file, or a folder of files with or without metadata.yaml
    /// @throws DataError with the file
    Bag(const std::filesystem::path& path, bool skip_broken);

    /// topics that were read by the calls of each() so far
    const std::vector<Topic>& topics() const { return topics_.topics(); }
    const std::vector<std::string>& notes() const { return notes_; }  ///< problems of the files
    const std::vector<std::filesystem::path>& files() const { return paths_; }
    /// Returns in which frame relidar stored the points, if relidar wrote the recording.
    /// Otherwise returns an empty string. Valid only after each().
    std::string points_in() const;

    /// Reads all files in order and passes each message to `take`.
    void each(const Wanted& wanted, const Take& take, const Progress& progress = {});
    /// Reads the bytes of one message at a known position. Any thread can call this
    /// function.
    SharedBytes read(const Place& place) const;

private:
    std::vector<std::filesystem::path> paths_;
    std::vector<std::unique_ptr<BagFile>> files_;
    TopicTable topics_;
    std::vector<std::string> notes_;

    void note(const std::string& text);
};

}  // namespace relidar::bag
