// SPDX-License-Identifier: Apache-2.0
// Writes the recordings of a rendering, and checks the names of topics and frames.

#include <cctype>
#include <set>
#include <system_error>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/simulate/render.hpp>
#include "base/base64.hpp"
#include "base/codecs/mcap_writer.hpp"
#include "base/fail.hpp"
#include "simulate/scan_files/recorded_moment.hpp"
#include "simulate/scan_files/recording_format.hpp"
#include "simulate/scan_files/scan_folder.hpp"

namespace relidar::scan_files {
namespace {

namespace fs = std::filesystem;

/// All scans of a rendering as one MCAP file. Until finish_writing() is called, the file
/// has a temporary name in the same folder.
class RecordingFileWriter {
public:
    /// @throws DataError if the file cannot be written
    RecordingFileWriter(fs::path path, const RecordingFormat& format, const RecordedRig& rig,
                        const FileMetadata& notes)
        : path_(std::move(path)),
          temporary_(make_temp_path(path_)),
          writer_(temporary_, format.profile),
          topics_(format.topics(rig)) {
        std::map<std::string, std::uint16_t> schemas;
        for (const RecordedTopic& topic : topics_) {
            if (!schemas.contains(topic.type))
                schemas[topic.type] =
                    writer_.add_schema(topic.type, format.definition_encoding, topic.definition);
            channels_.push_back(writer_.add_channel(schemas[topic.type], topic.name, format.message_encoding,
                                                    topic.metadata));
        }
        for (const auto& [name, values] : format.metadata) writer_.add_metadata(name, values);
        writer_.add_metadata("relidar", {notes.begin(), notes.end()});
    }
    RecordingFileWriter(const RecordingFileWriter&) = delete;
    RecordingFileWriter& operator=(const RecordingFileWriter&) = delete;
    ~RecordingFileWriter() {
        std::error_code failed;
        fs::remove(temporary_, failed);
    }

    const fs::path& path() const { return path_; }

    void write(const RecordedSweep& sweep) {
        for (const ScanMessage& message : sorted_messages(topics_, sweep)) {
            // Log times in the file must not decrease, although sweeps can overlap. A
            // message that is too early gets the log time of the previous message.
            last_logged_ns_ = std::max(last_logged_ns_, message.time_ns);
            writer_.add_message(channels_[message.topic], last_logged_ns_, message.bytes);
        }
        // A chunk per scan, because players display all messages of a scan together.
        writer_.write_chunk();
    }

    void finish_writing() {
        writer_.finish();
        write_atomically(path_, [&](const fs::path& file) { fs::rename(temporary_, file); });
    }

private:
    fs::path path_, temporary_;
    codecs::McapWriter writer_;
    std::vector<RecordedTopic> topics_;
    std::vector<std::uint16_t> channels_;  ///< [topics] numbers of the topics in the file
    std::uint64_t last_logged_ns_ = 0;
};

}  // namespace
}  // namespace relidar::scan_files

namespace relidar {
namespace {

namespace fs = std::filesystem;

bool is_topic_char(char character) {
    return std::isalnum(static_cast<unsigned char>(character)) != 0 || character == '_';
}

/// Returns true if a name is a valid ROS topic: one or more words, each after a slash. A
/// word does not begin with a digit.
bool is_topic_name(const std::string& topic) {
    if (topic.size() < 2 || topic.front() != '/' || topic.back() == '/') return false;
    for (std::size_t i = 1; i < topic.size(); ++i) {
        const bool begins_word = topic[i - 1] == '/';
        const bool is_digit = std::isdigit(static_cast<unsigned char>(topic[i])) != 0;
        if (begins_word && (topic[i] == '/' || is_digit)) return false;
        if (topic[i] != '/' && !is_topic_char(topic[i])) return false;
    }
    return true;
}

/// Checks the topic names and frame ids of all sensors.
/// @throws UsageError if a name is not valid in ROS, or if a frame id is used twice
void check_names(const scan_files::RecordedRig& rig) {
    std::set<std::string> used_frame_ids{scan_files::kWorldFrame, scan_files::kVehicleFrame};
    if (rig.has_map_frame()) used_frame_ids.insert(scan_files::kMapFrame);
    for (const scan_files::RecordedSensor& sensor : rig.sensors) {
        if (!is_topic_name(sensor.topic))
            fail<UsageError>(
                "cannot write a recording: found topic \"{}\", expected a name such as /lidar/points",
                sensor.topic);
        if (sensor.frame_id.empty() || sensor.frame_id.front() == '/' ||
            !used_frame_ids.insert(sensor.frame_id).second)
            fail<UsageError>(
                "cannot write a recording: found frame id \"{}\" of {}, expected a name other than {}",
                sensor.frame_id, sensor.topic, fmt::join(used_frame_ids, ", "));
    }
}

void check_unique_topics(const std::vector<scan_files::RecordedTopic>& topics) {
    std::set<std::string> topic_names;
    for (const scan_files::RecordedTopic& topic : topics)
        if (!topic_names.insert(topic.name).second)
            fail<UsageError>(
                "cannot write a recording: topic {} occurs twice, expected a different topic for each of {}",
                topic.name, fmt::join(topic_names, ", "));
}

const char* describe_rig_frame(const ScanOutputOptions& options) {
    if (options.frame == PointCoordinateFrame::world) return "world";
    return has_common_frame(options) ? "sensor at the stamp" : "sensor at each ray's firing time";
}

std::string format_seconds(std::int64_t time_ns) {
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    const std::string seconds = fmt::format("{}", time_ns / kSecond_ns);
    return time_ns % kSecond_ns == 0 ? seconds : fmt::format("{}.{:09}", seconds, time_ns % kSecond_ns);
}

/// Returns the metadata of a recording. All sensors share the run and the trajectory.
FileMetadata recording_metadata(const std::vector<ScanOutputOptions>& sensors) {
    const ScanOutputOptions& format = sensors.front();
    std::vector<std::string> names;
    for (const ScanOutputOptions& sensor : sensors)
        names.push_back(sensors.size() > 1 ? sensor.frame_id + ": " + sensor.sensor : sensor.sensor);
    return {{"relidar", RELIDAR_VERSION},
            {"run", format.run},
            {"dataset", format.config.dataset.path},
            {"sensor", fmt::format("{}", fmt::join(names, ", "))},
            {"trajectory", format.trajectory},
            {"time_shift_s", format_seconds(format.time_shift_ns)},
            {"points_in", describe_rig_frame(format)},
            {"units", "metres, seconds; intensity 0 to 1"}};
}

}  // namespace

std::string to_topic_name(const std::string& name) {
    std::string word = name;
    std::ranges::replace_if(
        word, [](char character) { return !is_topic_char(character); }, '_');
    if (!word.empty() && std::isdigit(static_cast<unsigned char>(word.front())))
        word.insert(word.begin(), '_');
    return word;
}

void name_topics(ScanOutputOptions& options, const std::string& name) {
    options.topic = name.empty() ? "/lidar/points" : "/lidar/" + to_topic_name(name) + "/points";
    options.frame_id = name.empty() ? "lidar" : name;
}

bool is_recording(const std::string& format) {
    return format == scan_files::kPacketFormat ||
           std::ranges::any_of(scan_files::recording_formats(),
                               [&](const auto& known) { return format == known.name; });
}

struct ScanRecordingsWriter::Impl {
    scan_files::SweepRecorder recorder;
    fs::path folder;
    std::vector<std::unique_ptr<scan_files::RecordingFileWriter>> files = {};
    std::unique_ptr<scan_files::PacketFileWriter> packets = {};
};

ScanRecordingsWriter::ScanRecordingsWriter(fs::path folder, std::vector<ScanOutputOptions> sensors) {
    scan_files::remove_scans(folder);  // checks that they are files of relidar
    impl_ = std::make_shared<Impl>(Impl{.recorder = scan_files::SweepRecorder(sensors), .folder = folder});
    const std::vector<std::string>& formats = sensors.front().formats;
    const scan_files::RecordedRig rig = impl_->recorder.recorded_rig();
    for (const scan_files::RecordingFormat& format : scan_files::recording_formats()) {
        if (std::ranges::find(formats, format.name) == formats.end()) continue;
        check_names(rig);
        check_unique_topics(format.topics(rig));
        impl_->files.push_back(std::make_unique<scan_files::RecordingFileWriter>(
            folder / format.file, format, rig, recording_metadata(sensors)));
    }
    if (std::ranges::find(formats, scan_files::kPacketFormat) == formats.end()) return;
    impl_->packets = std::make_unique<scan_files::PacketFileWriter>(folder, sensors);
}

void ScanRecordingsWriter::write_scans(std::span<const RenderedScan> scans) {
    if (impl_->packets) impl_->packets->write(scans);
    if (impl_->files.empty()) return;
    const scan_files::RecordedSweep sweep = impl_->recorder.record(scans);
    for (const auto& file : impl_->files) file->write(sweep);
}

void ScanRecordingsWriter::finish() {
    for (const auto& file : impl_->files) file->finish_writing();
    if (impl_->packets) impl_->packets->finish_writing();
    const std::vector<std::string> names = list_file_names();
    if (!names.empty()) scan_files::write_recordings(impl_->folder, names);
}

std::vector<std::string> ScanRecordingsWriter::list_file_names() const {
    std::vector<std::string> names;
    for (const auto& file : impl_->files) names.push_back(file->path().filename().string());
    if (impl_->packets)
        for (const std::string& name : impl_->packets->file_names()) names.push_back(name);
    return names;
}

struct ScanMessageEncoder::Impl {
    scan_files::SweepRecorder recorder;
    std::vector<scan_files::RecordedTopic> topics;
};

ScanMessageEncoder::ScanMessageEncoder(std::vector<ScanOutputOptions> sensors)
    : impl_(std::make_shared<Impl>(Impl{scan_files::SweepRecorder(std::move(sensors)), {}})) {
    impl_->topics = scan_files::foxglove_topics(impl_->recorder.recorded_rig());
}

std::vector<ScanTopic> ScanMessageEncoder::list_topics() const {
    std::vector<ScanTopic> topics;
    for (const scan_files::RecordedTopic& topic : impl_->topics) {
        const auto* schema = reinterpret_cast<const std::uint8_t*>(topic.definition.data());
        topics.push_back({topic.name, topic.type, encode_base64({schema, topic.definition.size()})});
    }
    return topics;
}

std::vector<ScanMessage> ScanMessageEncoder::encode(std::span<const RenderedScan> scans) {
    return scan_files::sorted_messages(impl_->topics, impl_->recorder.record(scans));
}

}  // namespace relidar
