// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/survey.hpp"

#include <algorithm>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/median.hpp"
#include "log/readers/bag/packets/ouster.hpp"
#include "log/readers/bag/packets/packet_messages.hpp"
#include "log/readers/bag/unpacked_file.hpp"

namespace relidar::bag {
namespace {

class Surveyor {
public:
    Surveyor(const Bag& bag, Survey& survey) : bag_(bag), survey_(survey) {}

    void process_message(const Message& message) {
        if (survey_.facts.size() <= message.topic) survey_.facts.resize(message.topic + 1);
        TopicFacts& facts = survey_.facts[message.topic];
        if (facts.n++ == 0) facts.first_ns = facts.last_ns = message.log_ns;
        facts.first_ns = std::min(facts.first_ns, message.log_ns);
        facts.last_ns = std::max(facts.last_ns, message.log_ns);
        try {
            const Topic& topic = bag_.topics()[message.topic];
            const Use use = get_topic_use(topic);
            if (use == Use::cloud) add_cloud(topic, message);
            if (use == Use::packets) add_packets(topic, message);
            if (use == Use::metadata) add_metadata(topic, message);
            if (use == Use::transforms) add_transforms(topic, message);
            if (use == Use::pose) add_pose(topic, message);
            if (use == Use::boxes) add_boxes(topic, message);
        } catch (const DataError& error) {
            if (facts.n_broken++ == 0) facts.broken = error.what();
        }
    }

    /// Returns true if some packets precede the metadata that is needed to decode them.
    /// They are then decoded in a second pass.
    bool needs_late_packets() const { return !late_.empty(); }
    bool is_late(std::size_t topic) const { return late_.contains(topic); }
    void add_late_packet(const Message& message) {
        TopicFacts& facts = survey_.facts[message.topic];
        try {
            add_packets(bag_.topics()[message.topic], message);
        } catch (const DataError& error) {
            if (facts.n_broken++ == 0) facts.broken = error.what();
        }
    }
    /// Reads sensor metadata from files next to the recording. A network capture needs
    /// them before its first packet, a bag before the second pass.
    void read_nearby_metadata() {
        if (has_read_metadata_) return;
        has_read_metadata_ = true;
        std::vector<std::string> broken;
        for (const std::filesystem::path& file : bag_.files())
            for (const auto& format : packets::find_ouster_metadata(get_unpacked_name(file), broken))
                ousters_.push_back(format);
        for (const std::string& text : broken) broken_metadata_ += fmt::format(" ({})", text);
    }

private:
    const Bag& bag_;
    Survey& survey_;
    /// Angle correction files next to the recording, read when the first packet arrives.
    std::optional<std::vector<packets::Correction>> corrections_;
    packets::OusterFormats ousters_;  ///< metadata known so far
    std::set<std::size_t> late_;      ///< topics with packets that were recorded before their metadata
    std::string broken_metadata_;
    bool has_read_metadata_ = false;

    void read_corrections() {
        corrections_.emplace();  // a file with an error is read only once
        std::vector<std::filesystem::path> names;
        for (const std::filesystem::path& file : bag_.files()) names.push_back(get_unpacked_name(file));
        corrections_ = packets::find_corrections(names);
    }

    void add_cloud(const Topic& topic, const Message& message) {
        const Cloud cloud = read_cloud(topic, message.bytes);
        CloudTopic& clouds = find_entry(survey_.clouds, message.topic);
        if (clouds.fields.empty()) clouds.fields = cloud.fields, clouds.frame = cloud.header.frame;
        if (cloud.size() == 0) {
            ++clouds.n_empty;
            return;
        }
        const auto n = std::uint32_t(std::min<std::size_t>(cloud.size(), UINT32_MAX));
        clouds.clouds.push_back({cloud.header.stamp_ns, message.log_ns, n, message.place});
        if (const std::optional<Arc> arc = compute_azimuth_range(cloud))
            clouds.arcs.push_back({cloud.header.stamp_ns, message.log_ns, message.place, n, *arc});
    }

    void add_packets(const Topic& topic, const Message& message) {
        Header header;
        const std::vector<packets::PacketView> views =
            packets::read_packets(topic, message.bytes, message.log_ns, header);
        if (views.empty()) return;
        if (!corrections_) read_corrections();
        packets::Calibration calibration{*corrections_};
        if (topic.encoding == packets::kDatagrams) read_nearby_metadata();
        calibration.ouster = packets::match_ouster_format(ousters_, topic.name, views.front().bytes);
        if (packets::has_ouster_packets(topic)) {
            if (!has_read_metadata_ && (late_.contains(message.topic) || !calibration.ouster))
                return void(late_.insert(message.topic));
            if (!calibration.ouster)
                throw DataError(packets::describe_ouster_packet(ousters_, bag_.files().front(), topic.name,
                                                                views.front().bytes.size()) +
                                broken_metadata_);
        }
        CloudTopic& clouds = find_entry(survey_.clouds, message.topic);
        clouds.frame = header.frame;
        clouds.packets.add(views, message.log_ns, message.place, calibration);
    }

    /// Adds the sensor metadata in a message. Drivers repeat it, so only the first
    /// message of a topic is used. Ignores messages with other content.
    void add_metadata(const Topic& topic, const Message& message) {
        if (std::ranges::any_of(ousters_, [&](const auto& known) { return known->where == topic.name; }))
            return;
        const std::string text = packets::read_text_message(topic, message.bytes);
        if (packets::is_ouster_metadata(text))
            ousters_.push_back(packets::read_ouster_metadata(text, topic.name));
    }

    void add_transforms(const Topic& topic, const Message& message) {
        const bool is_static = topic.name.ends_with("tf_static");
        for (const Transform& transform : read_transforms(topic, message.bytes))
            survey_.frames.add(transform, message.log_ns, is_static);
    }

    void add_pose(const Topic& topic, const Message& message) {
        const Transform transform = read_transforms(topic, message.bytes).front();
        PoseTopic& poses = find_entry(survey_.poses, message.topic);
        if (poses.samples.empty()) poses.parent = transform.header.frame, poses.child = transform.child;
        poses.samples.push_back({transform.header.stamp_ns, message.log_ns, transform.parent_from_child});
    }

    void add_boxes(const Topic& topic, const Message& message) {
        const BoxList list = read_boxes(topic, message.bytes);
        BoxTopic& boxes = find_entry(survey_.boxes, message.topic);
        boxes.n_left_out += list.n_left_out;
        if (list.boxes.empty()) return;
        if (boxes.frame.empty()) boxes.frame = list.boxes.front().header.frame;
        boxes.n_boxes += list.boxes.size();
        boxes.n_named +=
            std::size_t(std::ranges::count_if(list.boxes, [](const Box& box) { return !box.id.empty(); }));
        boxes.lists.push_back({list.boxes.front().header.stamp_ns, message.log_ns, message.place});
    }

    template <class Entry>
    static Entry& find_entry(std::vector<Entry>& entries, std::size_t topic) {
        const auto known = std::ranges::find(entries, topic, &Entry::topic);
        if (known != entries.end()) return *known;
        entries.emplace_back().topic = topic;
        return entries.back();
    }
};

/// Adds missing transforms of Ouster LiDARs, whose packets do not name a frame. Uses the
/// frames of Ouster's driver, rotated by 180 degrees to relidar's sensor frame.
void add_ouster_transforms(const Bag& bag, Survey& survey) {
    std::vector<CloudTopic*> ousters;
    for (CloudTopic& clouds : survey.clouds)
        if (packets::has_ouster_packets(bag.topics()[clouds.topic]) && !clouds.packets.empty())
            ousters.push_back(&clouds);
    for (CloudTopic* clouds : ousters) {
        const std::string& name = bag.topics()[clouds->topic].name;
        std::vector<std::string> prefixes{name.substr(0, name.rfind('/') + 1)};
        if (prefixes[0].starts_with('/')) prefixes[0].erase(0, 1);
        if (ousters.size() == 1) prefixes.emplace_back();
        for (const std::string& prefix : prefixes) {
            for (const char* frame : {"os_lidar", "os_sensor"})
                clouds->driver_frames.push_back(prefix + frame);
            if (survey.frames.find_path_to_root(clouds->frame).size() > 1 ||
                survey.frames.find_path_to_root(prefix + "os_lidar").size() < 2)
                continue;
            survey.frames.add({{0, prefix + "os_lidar"}, clouds->frame, {glm::dquat(0.0, 0.0, 0.0, 1.0), {}}},
                              0, true);
        }
    }
}

/// Joins clouds that are parts of a revolution. The revolution gets the time of its
/// middle part, because it begins at the back and the middle part is measured facing
/// forward.
void join_parts(CloudTopic& topic) {
    const JoinedTurns joined = join_turns(std::exchange(topic.arcs, {}));
    if (joined.turns.empty()) return;
    topic.clouds.clear();
    for (const std::vector<TurnPart>& turn : joined.turns) {
        const TurnPart& middle = turn[turn.size() / 2];
        CloudEntry& entry =
            topic.clouds.emplace_back(CloudEntry{middle.stamp_ns, middle.log_ns, 0, middle.place, 0, turn});
        for (const TurnPart& part : turn) entry.n_points += part.n_points;
    }
    topic.parts_about =
        fmt::format("{}; the clouds were combined into {} full turns of {} clouds{}", joined.about,
                    joined.turns.size(), joined.turns[joined.turns.size() / 2].size(),
                    joined.n_left_out == 0
                        ? ""
                        : fmt::format("; {} clouds of incomplete turns are skipped", joined.n_left_out));
}

}  // namespace

bool CloudTopic::has_field(folder::PointValue value) const {
    return std::ranges::any_of(
        fields, [&](const Cloud::Field& field) { return folder::find_value_of_field(field.name) == value; });
}

std::size_t CloudTopic::compute_median_points() const {
    if (clouds.empty()) return 0;
    std::vector<std::uint32_t> counts;
    for (const CloudEntry& cloud : clouds) counts.push_back(cloud.n_points);
    return compute_median(std::move(counts));
}

Survey survey_bag(Bag& bag, const Progress& progress) {
    Survey survey;
    Surveyor surveyor(bag, survey);
    bag.for_each_message([](const Topic& topic) { return get_topic_use(topic) != Use::nothing; },
                         [&](const Message& message) { surveyor.process_message(message); }, progress);
    survey.facts.resize(bag.topics().size());
    if (surveyor.needs_late_packets()) {
        surveyor.read_nearby_metadata();
        std::vector<bool> is_late;
        for (std::size_t t = 0; t < bag.topics().size(); ++t) is_late.push_back(surveyor.is_late(t));
        bag.for_each_message([&](const Topic& topic) { return packets::has_ouster_packets(topic); },
                             [&](const Message& message) {
                                 if (message.topic < is_late.size() && is_late[message.topic])
                                     surveyor.add_late_packet(message);
                             },
                             progress);
    }
    for (CloudTopic& clouds : survey.clouds) {
        clouds.packets.finish();
        clouds.turns = clouds.packets.turns();
        for (std::size_t t = 0; t < clouds.turns.size(); ++t) {
            const packets::PacketTurn& turn = clouds.turns[t];
            clouds.clouds.push_back(
                {turn.forward_ns, turn.log_ns, 0, clouds.packets.messages(turn).front().place, t});
        }
    }
    for (CloudTopic& clouds : survey.clouds) join_parts(clouds);
    add_ouster_transforms(bag, survey);
    return survey;
}

}  // namespace relidar::bag
