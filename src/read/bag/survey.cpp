// SPDX-License-Identifier: Apache-2.0
#include "read/bag/survey.hpp"

#include <algorithm>
#include <iterator>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/median.hpp"
#include "read/bag/packet_messages.hpp"
#include "read/bag/part_file.hpp"
#include "read/packets/ouster.hpp"

namespace relidar::bag {
namespace {

constexpr std::ptrdiff_t kMostLidarsOnTopic = 32;

/// Adds messages to the index of a recording.
class BagIndexer {
public:
    BagIndexer(BagRecording& bag, BagIndex& survey) : bag_(bag), survey_(survey) {}

    /// Adds all messages. Reads the packets again that were recorded before the metadata
    /// which are needed to decode them.
    void index_messages(const Progress& progress) {
        bag_.read_messages(
            [](const BagTopic& topic) { return find_purpose(topic) != MessagePurpose::nothing; },
            [&](const BagMessage& message) { index_message(message); }, progress);
        survey_.facts.resize(bag_.topics().size());  // adds topics without messages
        if (late_.empty()) return;
        read_metadata();
        const auto index_late = [&](const BagMessage& message) {
            if (late_.contains(message.topic))
                count_broken(message.topic, [&] { index_packets(bag_.topics()[message.topic], message); });
        };
        bag_.read_messages(is_ouster_topic, index_late, progress);
    }

private:
    BagRecording& bag_;
    BagIndex& survey_;
    std::optional<std::vector<packets::AngleCorrection>> corrections_;
    packets::MetadataList ousters_;  ///< metadata known so far
    std::set<std::size_t> late_;     ///< topics with packets that were recorded before their metadata
    std::string broken_metadata_;
    bool has_read_metadata_ = false;

    /// Reads the metadata of Ousters from files next to the recording. Called for network
    /// captures, and for packets without metadata in the recording.
    void read_metadata() {
        if (has_read_metadata_) return;
        has_read_metadata_ = true;
        std::vector<std::string> broken;
        for (const std::filesystem::path& file : bag_.file_paths())
            for (const auto& format : packets::read_metadata_files(strip_packed(file), broken))
                ousters_.push_back(format);
        for (const std::string& text : broken) broken_metadata_ += fmt::format(" ({})", text);
    }

    /// Counts a message and adds its content to the index.
    void index_message(const BagMessage& message) {
        if (survey_.facts.size() <= message.topic) survey_.facts.resize(message.topic + 1);
        TopicStatistics& facts = survey_.facts[message.topic];
        if (facts.n == 0) facts.first_ns = facts.last_ns = message.log_ns;
        ++facts.n;
        facts.first_ns = std::min(facts.first_ns, message.log_ns);
        facts.last_ns = std::max(facts.last_ns, message.log_ns);
        count_broken(message.topic, [&] {
            const BagTopic& topic = bag_.topics()[message.topic];
            switch (find_purpose(topic)) {
                case MessagePurpose::cloud: return index_cloud(topic, message);
                case MessagePurpose::packets: return index_packets(topic, message);
                case MessagePurpose::metadata: return index_metadata(topic, message);
                case MessagePurpose::transforms: return index_transforms(topic, message);
                case MessagePurpose::pose: return index_poses(topic, message);
                case MessagePurpose::boxes: return index_boxes(topic, message);
                case MessagePurpose::fix: return index_fix(topic, message);
                case MessagePurpose::nameless_boxes:
                case MessagePurpose::nothing: return;
            }
        });
    }

    /// Calls index(). If the message cannot be read, only counts it.
    template <class Function>
    void count_broken(std::size_t topic_index, const Function& index) {
        try {
            index();
        } catch (const DataError& error) {
            TopicStatistics& facts = survey_.facts[topic_index];
            if (facts.n_broken == 0) facts.broken = error.what();
            ++facts.n_broken;
        }
    }

    /// Adds a cloud to the entry of its LiDAR. Several LiDARs can share a topic.
    void index_cloud(const BagTopic& topic, const BagMessage& message) {
        const CloudMessage cloud = read_cloud(topic, message.bytes);
        CloudTopic& clouds = find_cloud_topic(message.topic, cloud);
        if (clouds.clouds.empty()) {
            clouds.fields = cloud.fields;
            clouds.frame = cloud.header.frame;
            clouds.lidar = cloud.lidar;
        }
        if (cloud.size() == 0) {
            ++clouds.n_empty;
            return;
        }
        if (cloud.header.frame != clouds.frame) {
            if (clouds.n_other_frame == 0) clouds.other_frame = cloud.header.frame;
            ++clouds.n_other_frame;
        }
        const auto n_points = std::uint32_t(std::min<std::size_t>(cloud.size(), UINT32_MAX));
        const MessageTimes times{cloud.header.stamp_ns, message.log_ns};
        clouds.clouds.push_back({times, n_points, message.message_position});
        clouds.clouds.back().arc = azimuth_arc(to_point_table(cloud, {nullptr, message.bytes}));
    }

    /// Returns the entry of the LiDAR of a cloud. Adds an entry for a new LiDAR. An empty
    /// cloud often has no frame, so it counts for any LiDAR of the topic. The same holds
    /// if the names of LiDARs are too many to be real.
    CloudTopic& find_cloud_topic(std::size_t topic_index, const CloudMessage& cloud) {
        const bool has_too_many =
            std::ranges::count(survey_.clouds, topic_index, &CloudTopic::topic) > kMostLidarsOnTopic;
        const auto entry = std::ranges::find_if(survey_.clouds, [&](const CloudTopic& known) {
            if (known.topic != topic_index) return false;
            return has_too_many || cloud.size() == 0 || known.clouds.empty() || known.lidar == cloud.lidar;
        });
        if (entry != survey_.clouds.end()) return *entry;
        survey_.clouds.emplace_back().topic = topic_index;
        return survey_.clouds.back();
    }

    /// Reads the angle correction files next to the recording, once.
    const std::vector<packets::AngleCorrection>& read_corrections() {
        if (corrections_) return *corrections_;
        corrections_.emplace();  // a file with an error is read only once
        std::vector<std::filesystem::path> names;
        for (const std::filesystem::path& file : bag_.file_paths()) names.push_back(strip_packed(file));
        corrections_ = packets::find_angle_files(names);
        return *corrections_;
    }

    /// Adds the packets of a message. Postpones Ouster packets without metadata.
    void index_packets(const BagTopic& topic, const BagMessage& message) {
        const auto [frame, views] = read_packets(topic, message.bytes, message.log_ns);
        if (views.empty()) return;
        packets::DecoderCalibration calibration{read_corrections()};
        if (topic.encoding == kLidarDatagrams) read_metadata();
        calibration.ouster = packets::find_metadata(ousters_, topic.name, views.front().bytes);
        if (is_ouster_topic(topic)) {
            const bool was_postponed = late_.contains(message.topic);
            if (!has_read_metadata_ && (was_postponed || !calibration.ouster)) {
                late_.insert(message.topic);
                return;
            }
            if (!calibration.ouster)
                throw DataError(packets::ouster_error(ousters_, bag_.file_paths().front(), topic.name,
                                                      views.front().bytes.size()) +
                                broken_metadata_);
        }
        CloudTopic& clouds = find_entry(survey_.clouds, message.topic);
        clouds.frame = frame;
        clouds.packets.add_packets(views, message.log_ns, message.message_position, calibration);
    }

    /// Adds the sensor metadata in a message. Uses only the first message of a topic,
    /// because drivers repeat it. Ignores messages with other content.
    void index_metadata(const BagTopic& topic, const BagMessage& message) {
        if (std::ranges::any_of(ousters_, [&](const auto& ouster) { return ouster->where == topic.name; }))
            return;
        const std::string text(MessageReader(topic, message.bytes).read_string());
        if (packets::is_metadata(text)) ousters_.push_back(packets::parse_metadata(text, topic.name));
    }

    /// Reads the transforms of a message. Counts transforms with an invalid pose.
    std::vector<TransformMessage> read_valid(const BagTopic& topic, const BagMessage& message) {
        TransformListMessage list = read_transforms(topic, message.bytes);
        TopicStatistics& facts = survey_.facts[message.topic];
        if (facts.n_left_out == 0) facts.left_out = list.problem;
        facts.n_left_out += list.n_left_out;
        return std::move(list.transforms);
    }

    /// Adds the transforms of a message to the tree of frames.
    void index_transforms(const BagTopic& topic, const BagMessage& message) {
        const bool is_static = topic.name.ends_with("tf_static");
        for (const TransformMessage& transform : read_valid(topic, message))
            survey_.frames.add_transform(transform, message.log_ns, is_static);
    }

    /// Adds the poses of a message to its topic. A path repeats its earlier poses, which
    /// are replaced, because a loop closure may have moved them.
    void index_poses(const BagTopic& topic, const BagMessage& message) {
        std::vector<TransformMessage> valid = read_valid(topic, message);
        const bool is_path = topic.type == kPathType;
        if (is_path) leave_out_unstamped(valid, survey_.facts[message.topic]);
        if (valid.empty()) return;
        PoseTopic& poses = find_entry(survey_.poses, message.topic);
        const auto is_replaced = [&](const StampedPose& sample) {
            return sample.stamp_ns >= valid.front().header.stamp_ns;
        };
        if (is_path) std::erase_if(poses.samples, is_replaced);
        if (poses.samples.empty()) {
            poses.parent = valid.front().header.frame;
            poses.child = valid.front().child;
        }
        for (const TransformMessage& transform : valid) {
            // The newest pose of a message is as old as the message.
            const std::int64_t age_ns = valid.back().header.stamp_ns - transform.header.stamp_ns;
            poses.samples.push_back(
                {{transform.header.stamp_ns, message.log_ns - age_ns}, transform.parent_from_child});
        }
    }

    /// Removes the poses of a path that have no time stamp, or the same as the previous
    /// pose, because their times are unknown.
    static void leave_out_unstamped(std::vector<TransformMessage>& poses, TopicStatistics& facts) {
        std::int64_t last_ns = 0;
        const auto n = std::erase_if(poses, [&](const TransformMessage& pose) {
            return pose.header.stamp_ns == std::exchange(last_ns, pose.header.stamp_ns) ||
                   pose.header.stamp_ns == 0;
        });
        if (n > 0 && facts.n_left_out == 0) facts.left_out = "has no time stamp of its own";
        facts.n_left_out += n;
    }

    void index_fix(const BagTopic& topic, const BagMessage& message) {
        const FixMessage fix = read_fix(topic, message.bytes);
        if (!fix.is_valid()) return;
        FixTopic& fixes = find_entry(survey_.fixes, message.topic);
        fixes.frame = fix.header.frame;
        fixes.samples.push_back({{fix.header.stamp_ns, message.log_ns}, fix.position});
    }

    /// Counts the boxes of a message. Stores its position to read the boxes later.
    void index_boxes(const BagTopic& topic, const BagMessage& message) {
        const BoxListMessage list = read_boxes(topic, message.bytes);
        BoxTopic& boxes = find_entry(survey_.boxes, message.topic);
        boxes.n_left_out += list.n_left_out;
        if (list.boxes.empty()) return;
        if (boxes.frame.empty()) boxes.frame = list.boxes.front().header.frame;
        boxes.n_boxes += list.boxes.size();
        boxes.n_named += std::size_t(
            std::ranges::count_if(list.boxes, [](const BoxMessage& box) { return !box.id.empty(); }));
        boxes.lists.push_back(
            {{list.boxes.front().header.stamp_ns, message.log_ns}, message.message_position});
    }

    /// Returns the entry of a topic. Adds an entry for a new topic.
    template <class Entry>
    static Entry& find_entry(std::vector<Entry>& entries, std::size_t topic_index) {
        const auto existing_entry = std::ranges::find(entries, topic_index, &Entry::topic);
        if (existing_entry != entries.end()) return *existing_entry;
        entries.emplace_back().topic = topic_index;
        return entries.back();
    }
};

/// Names the frames of the clouds that Ouster's driver makes from packets. Packets
/// contain no frame name, so their frame has the name of the topic. If the recording
/// contains the driver's frame `os_lidar`, adds the transform to it, half a turn about z.
void add_ouster_frames(const BagRecording& bag, BagIndex& index) {
    const auto is_ouster = [&](const CloudTopic& clouds) {
        return is_ouster_topic(bag.topics()[clouds.topic]) && !clouds.packets.empty();
    };
    const auto has_parent = [&](const std::string& frame) {
        return index.frames.path_to_root(frame).size() > 1;
    };
    const bool is_only_ouster = std::ranges::count_if(index.clouds, is_ouster) == 1;
    for (CloudTopic& clouds : index.clouds) {
        if (!is_ouster(clouds)) continue;
        // The driver prefixes its frames with the namespace of the topic: "os1/os_lidar"
        // for "/os1/lidar_packets". A driver of a single Ouster may use no prefix.
        const std::string& topic_name = bag.topics()[clouds.topic].name;
        std::string prefix = topic_name.substr(0, topic_name.rfind('/') + 1);
        if (prefix.starts_with('/')) prefix.erase(0, 1);
        std::vector<std::string> prefixes{prefix};
        if (is_only_ouster) prefixes.emplace_back();
        std::vector<std::string> lidar_frames;
        for (const std::string& each : prefixes) {
            lidar_frames.push_back(each + "os_lidar");
            clouds.driver_frames.insert(clouds.driver_frames.end(), {each + "os_lidar", each + "os_sensor"});
        }
        const auto lidar_frame = std::ranges::find_if(lidar_frames, has_parent);
        if (has_parent(clouds.frame) || lidar_frame == lidar_frames.end()) continue;
        const Pose half_turn{glm::dquat(0.0, 0.0, 0.0, 1.0), {}};  // w x y z
        index.frames.add_transform({{0, *lidar_frame}, clouds.frame, half_turn}, 0, /*is_static=*/true);
    }
}

/// Moves all clouds of an entry of a topic to another entry of the topic.
void move_clouds(CloudTopic& from, CloudTopic& to) {
    if (from.frame != to.frame) {
        if (to.n_other_frame == 0) to.other_frame = from.frame;
        to.n_other_frame += from.clouds.size();
    }
    std::ranges::move(std::exchange(from.clouds, {}), std::back_inserter(to.clouds));
}

/// Joins the entries of a topic (one per frame or LiDAR number of its clouds) that belong
/// to one LiDAR. An entry is a LiDAR of its own if it has many clouds that alternate with
/// those of the largest entry. Otherwise the frame has changed once, or for a few clouds.
void join_entries(std::vector<CloudTopic>& all, std::size_t topic) {
    constexpr double kLeastShare = 0.25;  // of the clouds of the largest entry
    std::vector<CloudTopic*> entries;
    for (CloudTopic& clouds : all)
        if (clouds.topic == topic) entries.push_back(&clouds);
    if (entries.size() == 1) entries[0]->lidar.clear();  // a single LiDAR needs no name
    if (entries.size() < 2) return;

    const auto n_clouds = [](const CloudTopic* entry) { return entry->clouds.size(); };
    const CloudTopic& largest = **std::ranges::max_element(entries, {}, n_clouds);
    const auto begins_before_end = [](const CloudTopic& entry, const CloudTopic& other) {
        return entry.clouds.front().message_position < other.clouds.back().message_position;
    };
    std::vector<CloudTopic*> lidars;
    for (CloudTopic* entry : entries) {
        const bool alternates = begins_before_end(*entry, largest) && begins_before_end(largest, *entry);
        const bool is_large = double(n_clouds(entry)) >= kLeastShare * double(n_clouds(&largest));
        if (entry == &largest || (alternates && is_large)) lidars.push_back(entry);
    }
    // So many entries cannot be real LiDARs. Then their names are wrong.
    const bool has_too_many = std::ssize(entries) > kMostLidarsOnTopic;
    if (lidars.size() == 1 || has_too_many) {
        lidars = {entries[0]};
        entries[0]->lidar.clear();
    }
    // The first LiDAR gets all clouds of the entries that are not a LiDAR.
    for (CloudTopic* entry : entries)
        if (std::ranges::find(lidars, entry) == lidars.end()) move_clouds(*entry, *lidars[0]);
    std::ranges::stable_sort(lidars[0]->clouds, {}, &CloudEntry::message_position);
    std::erase_if(all, [&](const CloudTopic& entry) { return entry.topic == topic && entry.clouds.empty(); });
}

/// Replaces clouds that are parts of a revolution by full revolutions.
void join_parts(CloudTopic& cloud_topic) {
    JoinedRevolutions joined = join_clouds(cloud_topic.clouds);
    if (joined.revolutions.empty()) return;
    cloud_topic.parts_note = fmt::format(
        "{}; these clouds were combined into {} full revolutions of {} clouds each{}", joined.note,
        joined.revolutions.size(), joined.revolutions[joined.revolutions.size() / 2].size(),
        joined.n_left_out == 0
            ? ""
            : fmt::format("; {} clouds of incomplete revolutions are skipped", joined.n_left_out));
    cloud_topic.clouds.clear();
    for (std::vector<CloudEntry>& parts : joined.revolutions) {
        // A revolution begins at the rear. It has the time of its middle part, in which
        // the head faces forward.
        CloudEntry& revolution = cloud_topic.clouds.emplace_back(parts[parts.size() / 2]);
        revolution.n_points = 0;
        for (const CloudEntry& part : parts) revolution.n_points += part.n_points;
        revolution.parts = std::move(parts);
    }
}

/// Adds each revolution of packets as a cloud. Its number of points is unknown.
void add_revolutions(CloudTopic& clouds) {
    clouds.packets.finish();
    for (std::size_t r = 0; r < clouds.packets.revolutions().size(); ++r) {
        const packets::PacketRevolution& revolution = clouds.packets.revolutions()[r];
        CloudEntry& cloud = clouds.clouds.emplace_back();
        cloud.stamp_ns = revolution.forward_ns;
        cloud.log_ns = revolution.log_ns;
        // names the file of the revolution in messages
        cloud.message_position = clouds.packets.messages_of(revolution).front().message_position;
        cloud.revolution_index = r;
    }
}

}  // namespace

bool CloudTopic::has_field(read::PointAttribute attribute) const {
    return std::ranges::any_of(fields, [&](const CloudMessage::CloudField& field) {
        return read::find_attribute(field.name) == attribute;
    });
}

std::string CloudTopic::make_name(const BagRecording& bag) const {
    return bag.topics()[topic].name + (lidar.empty() ? "" : ":" + lidar);
}

std::size_t CloudTopic::median_points() const {
    if (clouds.empty()) return 0;
    std::vector<std::uint32_t> counts;
    for (const CloudEntry& cloud : clouds) counts.push_back(cloud.n_points);
    return compute_median(std::move(counts));
}

BagIndex index_bag(BagRecording& bag, const Progress& progress) {
    BagIndex index;
    BagIndexer(bag, index).index_messages(progress);
    for (std::size_t t = 0; t < bag.topics().size(); ++t) join_entries(index.clouds, t);
    // A topic has either packets or clouds, which may be parts of a revolution.
    for (CloudTopic& clouds : index.clouds) {
        add_revolutions(clouds);
        join_parts(clouds);
    }
    add_ouster_frames(bag, index);
    return index;
}

}  // namespace relidar::bag
