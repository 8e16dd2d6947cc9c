// SPDX-License-Identifier: Apache-2.0
// Reads the box labels of KITTI-360, which are OpenCV XML files. A standing object is one
// child of the root element. A moving object has one child per frame. The 4x4 transform
// maps the unit cube around the origin to the box in the world. Its upper 3x3 block is
// rotation * diag(length, width, height).
#include "base/fail.hpp"
#include "read/datasets/kitti/kitti_360.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <optional>

#include <fmt/format.h>
#include <pugixml.hpp>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/files.hpp"
#include "read/kitti/log_files.hpp"

namespace relidar::kitti {
namespace {

/// All other classes (buildings, ground, poles) belong to the background.
struct MovableClass {
    int id;
    const char* name;
    const char* label;  ///< text label of the class, used if an object has no class number
};
constexpr MovableClass kMovableClasses[] = {
    {13, "car", "car"},           {14, "truck", "truck"},           {15, "trailer", "trailer"},
    {16, "caravan", "caravan"},   {17, "motorcycle", "motorcycle"}, {18, "bicycle", "bicycle"},
    {19, "person", "pedestrian"}, {20, "rider", "rider"},           {34, "bus", "bus"},
};

/// Reads an integer from an XML element, or returns `default_value` if the element does
/// not exist.
/// @throws DataError if the text is not an integer
int read_int(const pugi::xml_node& object, const char* field_name, std::optional<int> default_value,
             const std::string& where) {
    constexpr double kMaxValue = 1e8;
    const std::string text = object.child_value(field_name);
    if (text.empty() && default_value) return *default_value;
    const auto value = parse_number(trim(text));
    if (!value || !(std::abs(*value) < kMaxValue) || *value != std::floor(*value))
        fail("{}: {} is '{}', expected a whole number", where, field_name, quote(text));
    return int(*value);
}

/// Returns null for classes that cannot move. Drive 0004 has labels instead of class
/// numbers.
const MovableClass* find_movable(const pugi::xml_node& object, const std::string& where) {
    const bool has_number = !object.child("semanticId").empty();
    const int id = has_number ? read_int(object, "semanticId", {}, where) : 0;
    const std::string_view label = trim(object.child_value("label"));
    for (const MovableClass& movable_class : kMovableClasses)
        if (has_number ? id == movable_class.id : label == movable_class.name || label == movable_class.label)
            return &movable_class;
    return nullptr;
}

/// Reads the 4x4 transform of an object from a unit cube to the world. The transform
/// contains the pose and the size of the object.
glm::dmat4 read_transform(const pugi::xml_node& object, const std::string& where) {
    const pugi::xml_node matrix = object.child("transform");
    const int rows = read_int(matrix, "rows", {}, where + ": transform"),
              cols = read_int(matrix, "cols", {}, where + ": transform");
    const auto numbers = parse_numbers(matrix.child_value("data"));
    if (rows != 4 || cols != 4 || !numbers || numbers->size() != 16)
        fail(
            "{}: transform has {} rows and {} columns and contains {}, expected a matrix with 4 rows, 4 "
            "columns and 16 numbers",
            where, rows, cols,
            numbers ? fmt::format("{} numbers", numbers->size()) : "words that are not numbers");
    constexpr double kMaxValue = 1e8;
    glm::dmat4 m;
    for (int i = 0; i < 16; ++i) {
        const double value = (*numbers)[std::size_t(i)];
        if (!(std::abs(value) <= kMaxValue))
            fail("{}: number {} of the matrix transform is {}, expected a number from {:.0e} to {:.0e}",
                 where, i + 1, value, -kMaxValue, kMaxValue);
        m[i % 4][i / 4] = value;
    }
    return m;
}

/// Computes the size and the pose of a box from its transform. If the transform contains
/// a reflection, flips the width axis. The box stays the same, but its rotation becomes
/// valid.
void set_box(BoxLabel& label, const glm::dmat4& world_from_unit_box, const std::string& where) {
    glm::dmat3 axes(world_from_unit_box);
    label.size_m = {glm::length(axes[0]), glm::length(axes[1]), glm::length(axes[2])};
    constexpr double kMinBoxSize_m = 1e-3;
    if (!(std::min({label.size_m.x, label.size_m.y, label.size_m.z}) >= kMinBoxSize_m))
        fail(
            "{}: the matrix transform makes the box {} x {} x {} m large, expected each length to be at "
            "least {} m",
            where, label.size_m.x, label.size_m.y, label.size_m.z, kMinBoxSize_m);
    for (int c = 0; c < 3; ++c) axes[c] /= label.size_m[c];
    if (glm::determinant(axes) < 0.0) axes[1] = -axes[1];
    label.world_from_box = make_pose(axes, glm::dvec3(world_from_unit_box[3]), where + ": transform");
}

/// Returns the track id of an object: semanticId * 1000 + instanceId. Objects of drive
/// 0004 have no such numbers, so their id consists of class, "moving" and index.
std::string make_track_id(const pugi::xml_node& object, const MovableClass& movable_class, bool is_moving,
                          const std::string& where) {
    if (object.child("instanceId").empty())
        return fmt::format("{}-{}{}", movable_class.name, is_moving ? "moving-" : "",
                           read_int(object, is_moving ? "dynamicSeq" : "index", {}, where));
    return std::to_string(movable_class.id * 1000LL + read_int(object, "instanceId", {}, where));
}

using LabelsByFrame = std::map<int, BoxLabel>;

void add_object_labels(const pugi::xml_node& object, const std::vector<Frame>& frames,
                       std::map<std::string, LabelsByFrame>& labels_by_track_id, const std::string& where) {
    const MovableClass* movable_class = find_movable(object, where);
    if (!movable_class || object.child("transform").empty()) return;
    // A standing object has the timestamp -1 and a range of frames.
    const int at = read_int(object, "timestamp", -1, where);
    const int first = at < 0 ? read_int(object, "start_frame", {}, where) : at;
    const int last = at < 0 ? read_int(object, "end_frame", {}, where) : at;
    BoxLabel label{make_track_id(object, *movable_class, at >= 0, where), movable_class->name, {}, 0.0, {}};
    set_box(label, read_transform(object, where), where);
    auto frame = std::lower_bound(frames.begin(), frames.end(), first,
                                  [](const Frame& f, int number) { return f.index < number; });
    for (; frame != frames.end() && frame->index <= last; ++frame) {
        LabelsByFrame& track = labels_by_track_id[label.id];
        if (!track.empty() && track.begin()->second.category != label.category)
            fail(
                "{}: found class {} for track {}, which has class {} in another frame, expected one class "
                "per track",
                where, label.category, label.id, track.begin()->second.category);
        label.time_s = frame->time_s;
        track.emplace(frame->index, label);
    }
}

}  // namespace

std::vector<BoxTrack> read_360_boxes(const std::filesystem::path& label_file,
                                     const std::vector<Frame>& frames) {
    pugi::xml_document document;
    const std::string text = read_text_file(label_file);
    const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
    if (!parsed)
        fail("{}: malformed XML at byte {}: {}", label_file.string(), parsed.offset, parsed.description());
    const pugi::xml_node root = document.child("opencv_storage");
    if (!root)
        fail("{}: the element opencv_storage is missing, expected the boxes of KITTI-360",
             label_file.string());
    std::map<std::string, LabelsByFrame> tracks;
    for (const pugi::xml_node& object : root.children())
        add_object_labels(object, frames, tracks,
                          fmt::format("{}: {}", label_file.string(), quote(object.name())));
    std::vector<BoxLabel> labels;
    for (const auto& [id, track] : tracks)
        for (const auto& [frame, label] : track) labels.push_back(label);
    return build_tracks(labels);
}

}  // namespace relidar::kitti
