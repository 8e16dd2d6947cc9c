// SPDX-License-Identifier: Apache-2.0
// Reads boxes from vision_msgs/Detection3DArray and Autoware's TrackedObjects. The layout
// of vision_msgs depends on its version, which some recordings do not name. So the reader
// tries all known versions and uses the version that reads the message completely.
#include <algorithm>
#include <cmath>
#include <iterator>

#include "base/fail.hpp"
#include "read/bag/messages.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kPoseDoubles = std::tuple_size_v<PoseComponents>, kCovarianceDoubles = 36,
                      kTwistDoubles = 6 + kCovarianceDoubles;  // number of doubles
// number of bytes of a class with probability and of a point of three floats
constexpr std::size_t kLabelBytes = 5, kPointBytes = 12;
// maximum number of padding bytes that CDR appends after the last field
constexpr std::size_t kMaxPaddingBytes = 3;

void skip_doubles(MessageReader& reader, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) reader.read_number<double>();
}

glm::dvec3 read_vector3(MessageReader& reader) {
    glm::dvec3 v;
    for (int a = 0; a < 3; ++a) v[a] = reader.read_number<double>();
    return v;
}

/// Optional fields of Detection3D messages in one version of vision_msgs. They follow the
/// fields header, results and box, which every version has.
struct DetectionMessageLayout {
    bool has_text;      ///< true if classes are strings, false if they are numbers
    bool has_cloud;     ///< true if the message has the field source_cloud
    bool is_flagged;    ///< true if the message has the field is_tracking
    bool has_identity;  ///< id, formerly tracking_id
};
constexpr DetectionMessageLayout kDetectionLayouts[] = {
    {true, false, false, true},   // versions 3 and 4, ROS 2
    {true, true, true, true},     // version 2 for ROS 2
    {true, true, false, false},   // version 1 for ROS 2
    {false, true, false, false},  // older version for ROS 1
    {false, true, true, true},    // newer version for ROS 1
};

/// Reads the classes of a detection. Returns the one with the highest score.
std::string read_best_class(MessageReader& reader, const DetectionMessageLayout& layout) {
    // bytes of the score and the pose with its covariance, without the class
    constexpr std::size_t kLeastResult = 8 * (1 + kPoseDoubles + kCovarianceDoubles);
    std::string best;
    double best_score = -INFINITY;
    const std::size_t n = reader.read_length(kLeastResult);
    for (std::size_t i = 0; i < n; ++i) {
        const std::string name = layout.has_text
                                     ? std::string(reader.read_string())
                                     : fmt::format("class {}", reader.read_number<std::int64_t>());
        const auto score = reader.read_number<double>();
        skip_doubles(reader, kPoseDoubles + kCovarianceDoubles);
        if (best.empty() || score > best_score) {
            best = name;
            best_score = score;
        }
    }
    return best;
}

/// Reads the message as one version of vision_msgs. Throws if its length differs.
BoxListMessage read_by_layout(MessageReader reader, const DetectionMessageLayout& layout) {
    constexpr std::size_t kLeastDetection = 8 * 10;  // bytes of the pose and the size of the box
    BoxListMessage list{read_header(reader), {}, 0};
    const std::size_t n = reader.read_length(kLeastDetection);
    for (std::size_t i = 0; i < n; ++i) {
        BoxMessage box;
        box.header = read_header(reader);
        box.category = read_best_class(reader, layout);
        const PoseComponents pose = read_pose(reader);
        box.size_m = read_vector3(reader);
        // Also skips is_dense, the last field of source_cloud, which read_ros_cloud()
        // does not read.
        if (layout.has_cloud) {
            read_ros_cloud(reader);
            reader.read_number<std::uint8_t>();
        }
        if (layout.is_flagged) reader.read_number<std::uint8_t>();
        if (layout.has_identity) box.id = reader.read_string();
        if (box.header.frame.empty()) box.header = list.header;
        if (box.header.stamp_ns == 0) box.header.stamp_ns = list.header.stamp_ns;
        list.add_valid_box(std::move(box), pose);
    }
    if (reader.remaining() > (reader.is_ros1() ? 0 : kMaxPaddingBytes))
        fail("found {} bytes after the last of {} boxes, expected no bytes after the boxes",
             reader.remaining(), n);
    return list;
}

/// Reads a vision_msgs/Detection3DArray. The message does not state its version, so this
/// tries all versions until one fits exactly.
BoxListMessage read_detections(const MessageReader& reader) {
    std::string first_error;
    for (const DetectionMessageLayout& layout : kDetectionLayouts) {
        try {
            return read_by_layout(reader, layout);
        } catch (const DataError& error) {
            if (first_error.empty()) first_error = error.what();
        }
    }
    fail("the message matches no version of vision_msgs/Detection3DArray; the error with the newest is: {}",
         first_error);
}

/// Names of Autoware's ObjectClassification labels, indexed by label number.
constexpr const char* kAutowareLabels[] = {"unknown",    "car",     "truck",      "bus",   "trailer",
                                           "motorcycle", "bicycle", "pedestrian", "animal"};

/// Returns the most probable class of an object. A message may list several classes.
std::string read_best_label(MessageReader& reader) {
    std::uint8_t best = 0;
    float best_probability = -1.0f;
    const std::size_t n = reader.read_length(kLabelBytes);
    for (std::size_t i = 0; i < n; ++i) {
        const auto label = reader.read_number<std::uint8_t>();
        const auto probability = reader.read_number<float>();
        if (probability > best_probability) {
            best = label;
            best_probability = probability;
        }
    }
    return best < std::size(kAutowareLabels) ? kAutowareLabels[best] : fmt::format("class {}", best);
}

/// Returns a UUID as text, or an empty string if all bytes are 0.
std::string read_uuid(MessageReader& reader) {
    constexpr std::size_t kUuidBytes = 16;
    const std::string_view bytes = reader.read_bytes(kUuidBytes);
    std::string text;
    for (std::size_t i = 0; i < kUuidBytes; ++i) {
        // The text has groups of 4, 2, 2, 2 and 6 bytes.
        if (i == 4 || i == 6 || i == 8 || i == 10) text += '-';
        text += fmt::format("{:02x}", static_cast<unsigned char>(bytes[i]));
    }
    return std::ranges::all_of(bytes, [](char character) { return character == '\0'; }) ? "" : text;
}

/// Reads the shape of an object. For a polygon, which has no length and width, uses the
/// box around its footprint.
void read_shape(MessageReader& reader, BoxMessage& box, PoseComponents& pose) {
    constexpr std::uint8_t kPolygonShape = 2;
    const auto type = reader.read_number<std::uint8_t>();
    glm::dvec2 least(INFINITY), most(-INFINITY);
    const std::size_t n = reader.read_length(kPointBytes);
    for (std::size_t i = 0; i < n; ++i) {
        const auto x = reader.read_number<float>(), y = reader.read_number<float>();
        reader.read_number<float>();  // skips z
        least = glm::min(least, glm::dvec2(x, y));
        most = glm::max(most, glm::dvec2(x, y));
    }
    box.size_m = read_vector3(reader);
    if (type != kPolygonShape || n == 0) return;
    // The centre of the box is the middle of the polygon, in the object's frame.
    const glm::dvec2 middle = 0.5 * (least + most);
    const glm::dquat q(pose[6], pose[3], pose[4], pose[5]);  // w, x, y, z
    const glm::dvec3 shift = q * glm::dvec3(middle, 0.0);
    for (int a = 0; a < 3; ++a) pose[std::size_t(a)] += shift[a];
    box.size_m = {most - least, box.size_m.z};
}

/// Reads a list of tracked objects of Autoware.
/// @param is_autoware_auto  true for autoware_auto_perception_msgs, whose objects have
/// the additional flag "heading is available"
BoxListMessage read_objects(MessageReader& reader, bool is_autoware_auto) {
    // bytes of the id, and of pose, twist and acceleration with their covariances
    constexpr std::size_t kLeastObject = 16 + 8 * (kPoseDoubles + kCovarianceDoubles + 2 * kTwistDoubles);
    BoxListMessage list{read_header(reader), {}, 0};
    const std::size_t n = reader.read_length(kLeastObject);
    for (std::size_t i = 0; i < n; ++i) {
        BoxMessage box{list.header, read_uuid(reader), {}, {}, {}};
        reader.read_number<float>();  // skips the existence probability
        box.category = read_best_label(reader);
        PoseComponents pose = read_pose(reader);
        skip_doubles(reader, kCovarianceDoubles);
        if (is_autoware_auto) reader.read_number<std::uint8_t>();   // skips the orientation flag
        skip_doubles(reader, 2 * kTwistDoubles);                    // skips twist and acceleration
        if (!is_autoware_auto) reader.read_number<std::uint8_t>();  // skips the orientation flag
        reader.read_number<std::uint8_t>();                         // skips the flag is_stationary
        read_shape(reader, box, pose);
        list.add_valid_box(std::move(box), pose);
    }
    return list;
}

}  // namespace

void BoxListMessage::add_valid_box(BoxMessage box, const PoseComponents& pose) {
    const glm::dvec3& size_m = box.size_m;
    const bool has_size =
        std::isfinite(size_m.x + size_m.y + size_m.z) && std::min({size_m.x, size_m.y, size_m.z}) > 0.0;
    try {
        box.frame_from_box = make_pose(pose);
        if (has_size) boxes.push_back(std::move(box));
        else ++n_left_out;
    } catch (const DataError&) {
        ++n_left_out;
    }
}

BoxListMessage read_boxes(const BagTopic& topic, std::string_view message_bytes) {
    if (topic.encoding == "protobuf") return read_foxglove_boxes(message_bytes);
    MessageReader reader(topic, message_bytes);
    if (topic.type == "vision_msgs/Detection3DArray") return read_detections(reader);
    return read_objects(reader, topic.type.starts_with("autoware_auto"));
}

}  // namespace relidar::bag
