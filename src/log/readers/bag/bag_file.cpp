// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/bag_file.hpp"

#include <algorithm>
#include <array>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/readers/bag/unpacked_file.hpp"

namespace relidar::bag {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMetadata = "metadata.yaml";
constexpr std::int64_t kLatest_ns = 4294967296000000000;  // latest time stamp that ROS 1 can represent
constexpr std::array kEndings = {".mcap", ".db3", ".bag"};

bool is_pcap_file(const fs::path& file) {
    const std::string ending = remove_gz_extension(file).extension().string();
    return ending == ".pcap" || ending == ".pcapng";
}

/// The parts of rosbag2's metadata.yaml that describe the files. The parser reads line by
/// line and accepts only the layout that rosbag2 writes.
struct RosbagMetadata {
    std::vector<std::string> files;
    /// compression ("zstd"), and what is compressed ("file" or "message"), in lower case
    std::string compression, mode;
};

RosbagMetadata read_rosbag2_metadata(const fs::path& file) {
    RosbagMetadata metadata;
    bool in_files = false;
    for (const std::string& line : split_lines(read_text_file(file))) {
        const std::string_view text = trim_blanks_at_both_ends(line);
        const auto value_of = [&](std::string_view key) {
            std::string_view value = trim_blanks_at_both_ends(text.substr(key.size()));
            // Removes quotes.
            if (value.size() >= 2 && (value.front() == '"' || value.front() == '\'') &&
                value.back() == value.front())
                value = value.substr(1, value.size() - 2);
            return std::string(value);
        };
        if (text.starts_with("relative_file_paths:")) in_files = true;
        else if (in_files && text.starts_with("- ")) metadata.files.push_back(value_of("- "));
        else in_files = false;
        if (text.starts_with("compression_format:")) metadata.compression = value_of("compression_format:");
        if (text.starts_with("compression_mode:")) metadata.mode = value_of("compression_mode:");
    }
    std::ranges::transform(metadata.mode, metadata.mode.begin(),
                           [](unsigned char character) { return char(std::tolower(character)); });
    return metadata;
}

}  // namespace

std::size_t TopicTable::find_or_add_topic_index(BagTopic topic) {
    if (const std::size_t at = topic.type.find("/msg/"); at != std::string::npos) topic.type.erase(at, 4);
    const auto existing_topic = std::ranges::find_if(topics_, [&](const BagTopic& t) {
        return t.name == topic.name && t.type == topic.type && t.encoding == topic.encoding;
    });
    if (existing_topic != topics_.end()) return std::size_t(existing_topic - topics_.begin());
    topics_.push_back(std::move(topic));
    return topics_.size() - 1;
}

BagRecording::BagRecording(const fs::path& path, bool skip_broken) {
    RosbagMetadata metadata;
    if (!fs::is_directory(path)) {
        paths_ = {path};
        if (does_path_exist(path.parent_path() / kMetadata))
            metadata = read_rosbag2_metadata(path.parent_path() / kMetadata);
    } else if (does_path_exist(path / kMetadata)) {
        metadata = read_rosbag2_metadata(path / kMetadata);
        for (const std::string& name : metadata.files) {
            // Uses only the file name, because the folder may have been renamed.
            const fs::path file = path / fs::path(name).filename();
            if (does_path_exist(file)) paths_.push_back(file);
            else
                add_note_once(fmt::format("{}: this file of the recording is listed in {} but missing",
                                          file.string(), kMetadata));
        }
    }
    // Without files from metadata.yaml, uses all recordings in the folder. Sorts numbers
    // in names by value, so NAME_2 precedes NAME_10.
    if (paths_.empty()) {
        for (const fs::path& file : list_folder_entries(path))
            if (is_pcap_file(file) ||
                std::ranges::find(kEndings, file.extension().string()) != kEndings.end())
                paths_.push_back(file);
        std::ranges::stable_sort(paths_, {},
                                 [](const fs::path& file) { return file.filename().string().size(); });
    }
    if (paths_.empty())
        throw DataError(fmt::format(
            "{}: found no file of a recording, expected .mcap, .db3, .bag, .pcap or .pcapng", path.string()));
    for (const fs::path& file : paths_) {
        const std::string ending = file.extension().string();
        if (ending == ".zstd")
            throw DataError(
                fmt::format("{}: rosbag2 has compressed this file; unpack it with `zstd -d {}` and remove "
                            ".zstd from its name in {}",
                            file.string(), file.filename().string(), kMetadata));
        if (is_pcap_file(file)) files_.push_back(open_pcap_file(file));
        else if (ending == ".bag") files_.push_back(open_ros1_bag(file, skip_broken));
        else if (ending == ".db3")
            files_.push_back(
                open_rosbag2_sqlite(file, metadata.mode == "message" && metadata.compression == "zstd"));
        else files_.push_back(open_mcap_file(file, skip_broken));
    }
}

std::string BagRecording::get_points_frame_name() const {
    for (const auto& file : files_)
        if (std::string frame = file->get_points_frame_name(); !frame.empty()) return frame;
    return "";
}

void BagRecording::add_note_once(const std::string& text) {
    if (std::ranges::find(notes_, text) == notes_.end()) notes_.push_back(text);
}

void BagRecording::for_each_message(const TopicFilter& filter, const MessageCallback& callback,
                                    const ProgressReporter& progress) {
    for (std::size_t f = 0; f < files_.size(); ++f) {
        double last_reported_fraction = -1.0;
        const auto done = [&](double share) {
            if (!progress || share < last_reported_fraction + 0.01) return;
            last_reported_fraction = share;
            progress("reading the recording", (double(f) + share) / double(files_.size()));
        };
        const MessageCallback of_file = [&](BagMessage message) {
            if (message.log_ns < 0 || message.log_ns > kLatest_ns)
                throw DataError(
                    fmt::format("found a message with the recording time {} ns, expected 0 to {} ns",
                                message.log_ns, kLatest_ns));
            message.message_position.file = std::uint32_t(f);
            callback(message);
        };
        files_[f]->for_each_message(
            topics_, {filter, of_file, [&](const std::string& text) { add_note_once(text); }, done});
    }
}

SharedBytes BagRecording::read_message_bytes(const MessagePosition& message_position) const {
    try {
        return files_.at(message_position.file)->read_message_bytes(message_position);
    } catch (const DataError& error) {
        throw DataError(fmt::format("{}: {}", paths_.at(message_position.file).string(), error.what()));
    }
}

}  // namespace relidar::bag
