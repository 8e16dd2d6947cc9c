// SPDX-License-Identifier: Apache-2.0
#include "read/bag/bag_file.hpp"

#include <algorithm>
#include <optional>
#include <set>
#include <utility>

#include "base/codecs/unpack.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/bag/part_file.hpp"

namespace relidar::bag {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMetadataFile = "metadata.yaml";
constexpr std::int64_t kMaxRosTime_ns = 4294967296000000000;  // latest time stamp that ROS 1 can represent

bool is_pcap_file(const fs::path& file) {
    const std::string ending = strip_packed(file).extension().string();
    return ending == ".pcap" || ending == ".pcapng";
}

/// Removes a pair of quotation marks around a value of a YAML file.
std::string_view strip_quotes(std::string_view value) {
    if (value.size() < 2 || value.front() != value.back()) return value;
    const bool has_quotes = value.front() == '"' || value.front() == '\'';
    return has_quotes ? value.substr(1, value.size() - 2) : value;
}

/// Returns the files that rosbag2's metadata.yaml lists. Reads line by line and accepts
/// only the layout that rosbag2 writes.
std::vector<std::string> read_file_list(const fs::path& file) {
    std::vector<std::string> files;
    bool is_in_list = false;
    for (const std::string& line : split_lines(read_text_file(file))) {
        const std::string_view text = trim(line);
        if (text.starts_with("relative_file_paths:")) is_in_list = true;
        else if (is_in_list && text.starts_with("- ")) files.emplace_back(strip_quotes(trim(text.substr(2))));
        else is_in_list = false;
    }
    return files;
}

/// Returns a file of the recording. If it does not exist, returns its compressed or
/// unpacked copy, because metadata.yaml may name either.
fs::path find_packed_copy(const fs::path& file) {
    for (const fs::path& other : {fs::path(file.string() + ".zstd"), strip_packed(file)})
        if (!does_path_exist(file) && does_path_exist(other)) return other;
    return file;
}

/// Unpacks a message that rosbag2 compressed with zstd. Returns nothing if it is not
/// compressed; a serialized message cannot begin like zstd data.
/// @throws DataError if it is damaged
std::optional<std::string> unpack_message(const BagTopic& topic, std::string_view bytes) {
    if (topic.encoding != "cdr" || !bytes.starts_with(kZstdMagic)) return std::nullopt;
    // maximum size of an unpacked message in bytes, or in sizes of the packed message
    constexpr std::size_t kMostMessageBytes = std::size_t(64) << 20, kMostGrowth = 100;
    const std::size_t most_bytes = std::max(kMostMessageBytes, kMostGrowth * bytes.size());
    std::string unpacked;
    // stream_zstd() reads blocks until one is empty. The message is the only block.
    const auto read_block = [&] { return std::exchange(bytes, {}); };
    const auto write_block = [&](std::string_view block) {
        if (unpacked.append(block).size() > most_bytes) fail("found more than {} unpacked bytes", most_bytes);
    };
    if (!stream_zstd(read_block, write_block)) fail("the zstd data of the message are truncated");
    return unpacked;
}

/// Lists the recordings in a folder. Ignores a compressed file if its unpacked copy
/// exists. Sorts numbers in names by value, so NAME_2 precedes NAME_10.
std::vector<fs::path> list_recording_files(const fs::path& folder) {
    std::vector<fs::path> files;
    for (const fs::path& file : list_folder(folder)) {
        const fs::path unpacked = strip_packed(file);
        const bool is_copy = unpacked != file && does_path_exist(unpacked);
        if (is_pcap_file(file) || (is_recording_file(file) && !is_copy)) files.push_back(file);
    }
    // list_folder() sorts by name. Short names first puts NAME_2 before NAME_10.
    std::ranges::stable_sort(files, {}, [](const fs::path& file) { return file.filename().string().size(); });
    return files;
}

/// Returns the files of a recording: a single file, those that metadata.yaml lists, or if
/// there are none, all recordings in the folder.
/// @param notes  receives listed files that are missing
std::vector<fs::path> find_recording_files(const fs::path& path, std::vector<std::string>& notes) {
    if (!fs::is_directory(path)) return {path};
    std::vector<fs::path> files;
    if (does_path_exist(path / kMetadataFile))
        for (const std::string& name : read_file_list(path / kMetadataFile)) {
            // Uses only the file name, because the folder may have been renamed.
            const fs::path file = find_packed_copy(path / fs::path(name).filename());
            if (does_path_exist(file)) files.push_back(file);
            else
                notes.push_back(fmt::format("{}: this file of the recording is listed in {} but missing",
                                            file.string(), kMetadataFile));
        }
    return files.empty() ? list_recording_files(path) : files;
}

}  // namespace

std::size_t TopicTable::topic_index(BagTopic topic) {
    // ROS 1 and ROS 2 differ in this part of the type: sensor_msgs/msg/PointCloud2.
    constexpr std::string_view kRos2Part = "/msg";
    const std::size_t at = topic.type.find("/msg/");
    if (at != std::string::npos) topic.type.erase(at, kRos2Part.size());
    const auto existing_topic = std::ranges::find_if(topics_, [&](const BagTopic& known) {
        return known.name == topic.name && known.type == topic.type && known.encoding == topic.encoding;
    });
    if (existing_topic != topics_.end()) return std::size_t(existing_topic - topics_.begin());
    topics_.push_back(std::move(topic));
    return topics_.size() - 1;
}

std::size_t BagFile::find_topic(std::uint32_t channel, TopicTable& topics) {
    if (const auto known = channels_.find(channel); known != channels_.end()) return known->second;
    const auto listed = listed_.find(channel);
    if (listed == listed_.end())
        fail("a message belongs to channel {}, but no earlier record describes this channel", channel);
    return channels_[channel] = topics.topic_index(listed->second);
}

bool BagFile::skip_chunk(std::uint64_t chunk_offset, const std::vector<IndexEntry>& index, TopicTable& topics,
                         const ReadCallbacks& callbacks) {
    // Without this list, later chunks may need a description of a channel in this chunk.
    if (listed_.empty() || index.empty()) return false;
    for (const IndexEntry& entry : index)
        if (!listed_.contains(entry.channel) ||
            callbacks.topic_filter(topics.topics()[find_topic(entry.channel, topics)]))
            return false;
    for (const IndexEntry& entry : index)
        callbacks.pass(topics,
                       {find_topic(entry.channel, topics), entry.log_ns, {}, {chunk_offset, entry.in_chunk}});
    return true;
}

BagRecording::BagRecording(const fs::path& path, bool skip_broken)
    : paths_(find_recording_files(path, notes_)) {
    if (paths_.empty())
        fail("{}: found no file of a recording, expected .mcap, .db3, .bag, .pcap or .pcapng", path.string());
    for (const fs::path& file : paths_) {
        const std::string ending = strip_packed(file).extension().string();
        const UnpackedFile unpacked(file);
        const std::string problem =
            fmt::format("{}: the compressed data (gzip or zstd) are truncated", file.string());
        // A part of a database (.db3) cannot be read. Other formats are read in order.
        if (unpacked.is_truncated() && ending == ".db3") throw DataError(problem);
        if (unpacked.is_truncated()) add_note_once(problem + "; later messages are missing");
        if (is_pcap_file(file)) files_.push_back(open_pcap_file(unpacked.path(), file));
        else if (ending == ".bag") files_.push_back(open_ros1_bag(unpacked.path(), skip_broken));
        else if (ending == ".db3") files_.push_back(open_sqlite_bag(unpacked.path()));
        else files_.push_back(open_mcap_file(unpacked.path(), skip_broken));
    }
}

std::string BagRecording::points_frame() const {
    for (const auto& file : files_)
        if (std::string frame = file->points_frame(); !frame.empty()) return frame;
    return "";
}

void BagRecording::add_note_once(const std::string& text) {
    if (std::ranges::find(notes_, text) == notes_.end()) notes_.push_back(text);
}

/// Reads the messages of all files, one file after another. Unpacks compressed messages
/// of the requested topics. Replaces impossible recording times, with a note.
void BagRecording::read_messages(const TopicFilter& filter, const MessageCallback& callback,
                                 const Progress& progress) {
    std::set<std::size_t> noted_topics;  // topics with a note about recording times
    for (std::size_t file_index = 0; file_index < files_.size(); ++file_index) {
        double last_reported_share = -1.0;
        const auto report_progress = [&](double share) {
            if (!progress || share < last_reported_share + 0.01) return;
            last_reported_share = share;
            progress("reading the recording", (double(file_index) + share) / double(files_.size()));
        };
        std::int64_t previous_ns = 0;
        const MessageCallback pass_message = [&](BagMessage message) {
            const BagTopic& topic = topics_.topics()[message.topic];
            message.message_position.file = std::uint32_t(file_index);
            const std::int64_t stored_ns = message.log_ns;
            const bool is_possible = stored_ns >= 0 && stored_ns <= kMaxRosTime_ns;
            // The time of the previous message of any topic replaces an impossible one.
            if (!is_possible) message.log_ns = previous_ns;
            previous_ns = message.log_ns;
            const bool is_requested = filter(topic);  // others are only counted
            if (is_requested && !is_possible && noted_topics.insert(message.topic).second)
                add_note_once(
                    fmt::format("topic {}: a message has the recording time {} ns, expected 0 to {} ns; "
                                "the time of the previous message is used",
                                quote(topic.name), stored_ns, kMaxRosTime_ns));
            std::optional<std::string> unpacked;
            try {
                if (is_requested) unpacked = unpack_message(topic, message.bytes);
            } catch (const DataError&) {}  // the reader of the message reports the packed bytes
            if (unpacked) message.bytes = *unpacked;
            callback(message);
        };
        const auto add_note = [&](const std::string& text) { add_note_once(text); };
        files_[file_index]->read_messages(topics_, {filter, pass_message, add_note, report_progress});
    }
}

SharedBytes BagRecording::read_message(const BagTopic& topic, const MessagePosition& message_position) const {
    try {
        SharedBytes bytes = files_.at(message_position.file)->read_message(message_position);
        std::optional<std::string> unpacked = unpack_message(topic, bytes.bytes);
        return unpacked ? share_bytes(std::move(*unpacked)) : bytes;
    } catch (const DataError& error) {
        fail("{}: {}", paths_.at(message_position.file).string(), error.what());
    }
}

}  // namespace relidar::bag
