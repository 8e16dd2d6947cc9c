// SPDX-License-Identifier: Apache-2.0
// Writes the boxes of actors as vision_msgs/Detection3DArray messages and as Autoware's
// tracked objects.
#include "simulate/scan_files/recording_format.hpp"

#include <cctype>

namespace relidar::scan_files {
namespace {

using Actors = std::vector<RecordedActor>;

/// Returns a Detection3DArray message with one detection per actor. Each detection has
/// the time at which the sensor points at the box.
std::string encode_detections(std::uint64_t stamp_ns, const Actors& actors) {
    codecs::CdrWriter cdr;
    add_header(cdr, stamp_ns, kWorldFrame);
    cdr.add_number(std::uint32_t(actors.size()));
    for (const RecordedActor& actor : actors) {
        add_header(cdr, actor.faced.time_ns, kWorldFrame);
        // one class with a score of 1, because the class is known exactly
        cdr.add_number(std::uint32_t(1)).append_string(actor.category).add_number(1.0);
        add_pose(cdr, actor.faced.world_from_box);
        add_covariance(cdr);
        add_pose(cdr, actor.faced.world_from_box);
        add_vector(cdr, actor.size_m);
        cdr.append_string(actor.name);
    }
    return cdr.take_message();
}

/// The first matching word decides, so "caravan" precedes "car".
struct AutowareLabel {
    const char* word;
    std::uint8_t number;
};
constexpr AutowareLabel kAutowareLabels[] = {
    {"caravan", 4}, {"trailer", 4}, {"truck", 2}, {"large_vehicle", 2}, {"bus", 3},    {"motorcycl", 5},
    {"bicycl", 6},  {"cyclist", 6}, {"rider", 6}, {"pedestrian", 7},    {"person", 7}, {"people", 7},
    {"animal", 8},  {"dog", 8},     {"car", 1},   {"van", 1},           {"vehicle", 1}};
constexpr std::uint8_t kUnknownLabel = 0;

/// Returns Autoware's number of the class whose word the dataset's category contains.
std::uint8_t autoware_label(std::string category) {
    std::ranges::transform(category, category.begin(), [](unsigned char character) {
        return static_cast<char>(std::tolower(character));
    });
    const auto match = std::ranges::find_if(kAutowareLabels, [&](const AutowareLabel& label) {
        return category.find(label.word) != std::string::npos;
    });
    return match == std::end(kAutowareLabels) ? kUnknownLabel : match->number;
}

/// Adds a UUID that depends only on a name, so that an actor has the same UUID in all
/// files. It consists of two FNV-1a hashes. Its version is 8 (custom UUID).
void add_uuid(codecs::CdrWriter& cdr, const std::string& name) {
    constexpr int kVersionByte = 6, kVariantByte = 8;
    std::string bytes;
    for (std::uint64_t hash : {0xcbf29ce484222325u, 0x84222325cbf29ce4u}) {
        for (const char c : name) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
        append_raw(bytes, hash);
    }
    for (int i = 0; i < 16; ++i) {
        auto byte = static_cast<std::uint8_t>(bytes[std::size_t(i)]);
        if (i == kVersionByte) byte = 0x80 | (byte & 0x0f);
        if (i == kVariantByte) byte = 0x80 | (byte & 0x3f);
        cdr.add_number(byte);
    }
}

/// Returns a TrackedObjects message with the boxes of all actors. The objects have no
/// time stamps, so their poses are at the time of the message.
std::string encode_tracked(std::uint64_t stamp_ns, const Actors& actors) {
    constexpr std::uint8_t kOrientationAvailable = 2, kBoundingBox = 0;
    codecs::CdrWriter cdr;
    add_header(cdr, stamp_ns, kWorldFrame);
    cdr.add_number(std::uint32_t(actors.size()));
    for (const RecordedActor& actor : actors) {
        add_uuid(cdr, actor.name);
        // Existence probability, then one class with its label and probability. Both
        // probabilities are 1.
        cdr.add_number(1.0f)
            .add_number(std::uint32_t(1))
            .add_number(autoware_label(actor.category))
            .add_number(1.0f);
        add_pose(cdr, actor.at_stamp.world_from_box);
        add_covariance(cdr);
        add_velocity(cdr, actor.at_stamp.velocity);
        add_velocity(cdr, {});  // zero acceleration, because the acceleration is unknown
        cdr.add_number(kOrientationAvailable).add_number(std::uint8_t(actor.is_parked));
        cdr.add_number(kBoundingBox).add_number(std::uint32_t(0));  // an empty footprint
        add_vector(cdr, actor.size_m);
    }
    return cdr.take_message();
}

}  // namespace

std::vector<RecordedTopic> ros_actor_topics() {
    const auto topic = [](const char* name, const char* type,
                          std::string (*message)(std::uint64_t, const Actors&)) {
        return make_ros_topic(name, type, [message](const RecordedSweep& moment) {
            return std::vector<RecordedMessage>{{moment.last_ns, message(moment.first_ns, moment.actors)}};
        });
    };
    return {topic("/actors", "vision_msgs/msg/Detection3DArray", encode_detections),
            topic("/actors_autoware", "autoware_perception_msgs/msg/TrackedObjects", encode_tracked)};
}

}  // namespace relidar::scan_files
