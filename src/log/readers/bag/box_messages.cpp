// SPDX-License-Identifier: Apache-2.0
// Reads boxes from vision_msgs/Detection3DArray and Autoware's TrackedObjects. The layout
// depends on the version of vision_msgs, and some recordings do not name the version. So
// the reader tries all known versions and uses the version that consumes the complete
// message.
#include <algorithm>
#include <cmath>
#include <iterator>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "log/readers/bag/message_reader.hpp"
#include "log/readers/bag/messages.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kCovariance = 36, kTwist = 6 + kCovariance;  // number of doubles
// maximum number of padding bytes that CDR appends after the last field
constexpr std::size_t kPadding = 3;

void skip_numbers(MessageReader& reader, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) reader.number<double>();
}

glm::dvec3 read_vector(MessageReader& reader) {
    glm::dvec3 v;
    for (int a = 0; a < 3; ++a) v[a] = reader.number<double>();
    return v;
}

/// A box with the values of the message, which are not checked yet.
struct Draft {
    Header header;
    std::string id, category;
    PoseNumbers pose{};
    glm::dvec3 size_m{0.0};
};

void add_box(BoxList& list, const Draft& draft) {
    const glm::dvec3& s = draft.size_m;
    const bool has_size = std::isfinite(s.x + s.y + s.z) && std::min({s.x, s.y, s.z}) > 0.0;
    try {
        if (has_size)
            list.boxes.push_back({draft.header, draft.id, draft.category, s, make_pose(draft.pose)});
        else ++list.n_left_out;
    } catch (const DataError&) {
        ++list.n_left_out;
    }
}

/// Optional fields of Detection3D messages in one version of vision_msgs. They follow the
/// fields header, results and box, which every version has.
struct DetectionLayout {
    bool has_text;      ///< true if classes are strings, false if they are numbers
    bool has_cloud;     ///< true if the message has the field source_cloud
    bool is_flagged;    ///< true if the message has the flag is_tracking
    bool has_identity;  ///< id, formerly tracking_id
};
constexpr DetectionLayout kDetectionLayouts[] = {
    {true, false, false, true},   // versions 3 and 4, ROS 2
    {true, true, true, true},     // version 2 for ROS 2
    {true, true, false, false},   // version 1 for ROS 2
    {false, true, false, false},  // older version for ROS 1
    {false, true, true, true},    // newer version for ROS 1
};

/// Reads the classification results of a detection. Returns the class with the highest
/// score.
std::string read_class(MessageReader& reader, const DetectionLayout& layout) {
    constexpr std::size_t kLeastResult = 8 * (1 + 7 + kCovariance);
    std::string best;
    double best_score = -INFINITY;
    const std::size_t n = reader.length(kLeastResult);
    for (std::size_t i = 0; i < n; ++i) {
        const std::string name = layout.has_text ? std::string(reader.text())
                                                 : fmt::format("class {}", reader.number<std::int64_t>());
        const auto score = reader.number<double>();
        skip_numbers(reader, std::tuple_size_v<PoseNumbers> + kCovariance);
        if (best.empty() || score > best_score) best = name, best_score = score;
    }
    return best;
}

BoxList read_detections(MessageReader reader, const DetectionLayout& layout) {
    constexpr std::size_t kLeastDetection = 8 * 10;
    BoxList list{read_header(reader), {}, 0};
    const std::size_t n = reader.length(kLeastDetection);
    for (std::size_t i = 0; i < n; ++i) {
        Draft box{read_header(reader),
                  {},
                  read_class(reader, layout),
                  read_pose_numbers(reader),
                  read_vector(reader)};
        // Also skips is_dense, the last field of source_cloud, which read_point_cloud()
        // leaves unread.
        if (layout.has_cloud) read_point_cloud(reader), reader.number<std::uint8_t>();
        if (layout.is_flagged) reader.number<std::uint8_t>();
        if (layout.has_identity) box.id = reader.text();
        if (box.header.frame.empty()) box.header = list.header;
        if (box.header.stamp_ns == 0) box.header.stamp_ns = list.header.stamp_ns;
        add_box(list, box);
    }
    if (reader.left() > (reader.is_ros1() ? 0 : kPadding))
        throw DataError(
            fmt::format("found {} bytes after the last of {} boxes, expected none", reader.left(), n));
    return list;
}

BoxList read_detections(const MessageReader& reader) {
    std::string why;
    for (const DetectionLayout& layout : kDetectionLayouts) {
        try {
            return read_detections(reader, layout);
        } catch (const DataError& error) {
            if (why.empty()) why = error.what();
        }
    }
    throw DataError(
        fmt::format("cannot read the message as any version of vision_msgs/Detection3DArray; "
                    "as the newest version: {}",
                    why));
}

/// Names of Autoware's ObjectClassification labels, indexed by label number.
constexpr const char* kLabels[] = {"unknown",    "car",     "truck",      "bus",   "trailer",
                                   "motorcycle", "bicycle", "pedestrian", "animal"};

std::string read_label(MessageReader& reader) {
    std::uint8_t best = 0;
    float best_probability = -1.0f;
    const std::size_t n = reader.length(5);
    for (std::size_t i = 0; i < n; ++i) {
        const auto label = reader.number<std::uint8_t>();
        const auto probability = reader.number<float>();
        if (probability > best_probability) best = label, best_probability = probability;
    }
    return best < std::size(kLabels) ? kLabels[best] : fmt::format("class {}", best);
}

/// Reads a UUID. Returns it as hexadecimal text with dashes, or an empty string if all
/// bytes are 0.
std::string read_uuid(MessageReader& reader) {
    constexpr std::size_t kBytes = 16;
    const std::string_view bytes = reader.take(kBytes);
    std::string text;
    for (std::size_t i = 0; i < kBytes; ++i) {
        if (i == 4 || i == 6 || i == 8 || i == 10) text += '-';
        text += fmt::format("{:02x}", static_cast<unsigned char>(bytes[i]));
    }
    return std::ranges::all_of(bytes, [](char character) { return character == '\0'; }) ? "" : text;
}

/// Reads the shape of an object and sets the size of its box. A polygon has no length and
/// width, so the bounding box of its footprint is used.
void read_shape(MessageReader& reader, Draft& box) {
    constexpr std::uint8_t kPolygon = 2;
    const auto type = reader.number<std::uint8_t>();
    glm::dvec2 least(INFINITY), most(-INFINITY);
    const std::size_t n = reader.length(12);
    for (std::size_t i = 0; i < n; ++i) {
        const auto x = reader.number<float>(), y = reader.number<float>();
        reader.number<float>();
        least = glm::min(least, glm::dvec2(x, y));
        most = glm::max(most, glm::dvec2(x, y));
    }
    box.size_m = read_vector(reader);
    if (type != kPolygon || n == 0) return;
    const glm::dvec2 middle = 0.5 * (least + most);
    const glm::dquat q(box.pose[6], box.pose[3], box.pose[4], box.pose[5]);
    const glm::dvec3 shift = q * glm::dvec3(middle, 0.0);
    for (int a = 0; a < 3; ++a) box.pose[std::size_t(a)] += shift[a];
    box.size_m = {most - least, box.size_m.z};
}

/// Reads a list of tracked objects.
/// @param is_auto  true for autoware_auto_perception_msgs, whose objects have the
/// additional flag "heading is available"
BoxList read_objects(MessageReader& reader, bool is_auto) {
    constexpr std::size_t kLeastObject = 16 + 8 * (7 + kCovariance + 2 * kTwist);
    BoxList list{read_header(reader), {}, 0};
    const std::size_t n = reader.length(kLeastObject);
    for (std::size_t i = 0; i < n; ++i) {
        Draft box{list.header, read_uuid(reader), {}, {}, {}};
        reader.number<float>();  // skips the existence probability
        box.category = read_label(reader);
        box.pose = read_pose_numbers(reader);
        skip_numbers(reader, kCovariance);
        if (is_auto) reader.number<std::uint8_t>();
        skip_numbers(reader, 2 * kTwist);  // skips twist and acceleration
        if (!is_auto) reader.number<std::uint8_t>();
        reader.number<std::uint8_t>();  // skips the flag is_stationary
        read_shape(reader, box);
        add_box(list, box);
    }
    return list;
}

}  // namespace

BoxList read_boxes(const Topic& topic, std::string_view bytes) {
    if (topic.encoding == "protobuf") return read_foxglove_boxes(bytes);
    MessageReader reader(bytes, topic.encoding == "ros1");
    if (topic.type == "vision_msgs/Detection3DArray") return read_detections(reader);
    return read_objects(reader, topic.type.starts_with("autoware_auto"));
}

}  // namespace relidar::bag
