// SPDX-License-Identifier: Apache-2.0
// Recordings of ROS: MCAP, rosbag2 in SQLite, ROS 1 bags, captures of a network, and
// folders of their parts, as one list of messages. Nothing of a message is looked at
// here.
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

/// A topic of a recording. Two of one name and different types are two.
struct Topic {
    std::string name;
    std::string type;      ///< "sensor_msgs/PointCloud2": the "/msg/" of ROS 2 is left out
    std::string encoding;  ///< of its messages: "cdr", "ros1", "protobuf" ...
};

/// Where a message lies.
struct Place {
    static constexpr std::uint64_t kNoChunk = std::numeric_limits<std::uint64_t>::max();

    /// byte of the chunk, or of the message's record, in its file; of SQLite: its row
    std::uint64_t at = 0;
    std::uint64_t in_chunk = kNoChunk;  ///< byte of the message's record in the unpacked chunk
    std::uint32_t file = 0;             ///< of the recording

    auto operator<=>(const Place&) const = default;
};

struct Message {
    std::size_t topic = 0;    ///< in Bag::topics()
    std::int64_t log_ns = 0;  ///< when it was recorded
    std::string_view bytes;   ///< valid during the call alone; none of a topic whose messages are not wanted
    Place place;
};

/// Whether what a topic's messages hold is of interest, or only that and when they came.
using Wanted = std::function<bool(const Topic&)>;
using Take = std::function<void(const Message&)>;

/// The topics of all files of a recording, as they are met.
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
    /// What each() needs beside the file.
    struct Pass {
        const Wanted& wanted;
        const Take& take;
        std::function<void(const std::string&)> note;  ///< what is wrong with the file
        std::function<void(double)> done;              ///< share of the file that is read
    };
    /// All messages in the order of the file. @throws DataError naming what is wrong at
    /// which byte
    virtual void each(TopicTable& topics, const Pass& pass) = 0;
    /// One message again; from any thread.
    virtual SharedBytes read(const Place& place) const = 0;
    /// Frame of the points as relidar's own recordings say it, after a pass; empty for
    /// other recordings.
    virtual std::string points_in() const { return ""; }
};

/// By the kinds of file. @param skip_broken  damaged chunks are left out with a note, not
/// an error
std::unique_ptr<BagFile> open_mcap(const std::filesystem::path& file, bool skip_broken);
std::unique_ptr<BagFile> open_pcap(const std::filesystem::path& file);
std::unique_ptr<BagFile> open_ros1(const std::filesystem::path& file, bool skip_broken);
/// @param packed  rosbag2 compressed each message with zstd
std::unique_ptr<BagFile> open_sqlite(const std::filesystem::path& file, bool packed);

/// A recording of one file or of several.
class Bag {
public:
    /// @param path  a file, or a folder of files, with metadata.yaml or without @throws
    /// DataError naming the file
    Bag(const std::filesystem::path& path, bool skip_broken);

    const std::vector<Topic>& topics() const { return topics_.topics(); }  ///< that passes have met
    const std::vector<std::string>& notes() const { return notes_; }       ///< what the files lack
    const std::vector<std::filesystem::path>& files() const { return paths_; }
    /// Frame of the points as relidar's own recordings say it, after a pass; empty for
    /// other recordings.
    std::string points_in() const;

    /// A pass over all files. Messages come in the order in which they lie there.
    void each(const Wanted& wanted, const Take& take, const Progress& progress = {});
    /// One message again; from any thread.
    SharedBytes read(const Place& place) const;

private:
    std::vector<std::filesystem::path> paths_;
    std::vector<std::unique_ptr<BagFile>> files_;
    TopicTable topics_;
    std::vector<std::string> notes_;

    void note(const std::string& text);
};

}  // namespace relidar::bag
