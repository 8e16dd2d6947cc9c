// SPDX-License-Identifier: Apache-2.0
// Reads tracklet_labels.xml, a boost archive. Each item is an object with one pose per
// frame, beginning at first_frame. A pose is in the sensor frame at the time when the
// head faces forward. The position in the file is the centre of the box's bottom face, so
// centre = t + R (0, 0, h/2).
#include "base/fail.hpp"
#include "read/kitti/log_files.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <pugixml.hpp>

#include <relidar/base/error.hpp>
#include "base/files.hpp"

namespace relidar::kitti {
namespace {

constexpr double kLargestOfLabel = 1e6;

/// @throws DataError with track and field if the number is missing or out of range
double read_number_field(const pugi::xml_node& node, const char* field_name,
                         const std::string& error_location) {
    const std::string text = node.child_value(field_name);
    const auto value = parse_number(trim_blanks_at_both_ends(text));
    if (!value || !(std::abs(*value) <= kLargestOfLabel))
        fail("{}: {} is '{}', expected a finite number of at most {:.0e}", error_location, field_name,
             shorten_for_error_message(text), kLargestOfLabel);
    return *value;
}

Pose read_box_pose_in_sensor_frame(const pugi::xml_node& pose_item, double box_height_m,
                                   const std::string& error_location) {
    const auto get = [&](const char* field) { return read_number_field(pose_item, field, error_location); };
    const glm::dquat rotation = make_rotation(get("rz"), get("ry"), get("rx"));
    return {rotation,
            glm::dvec3(get("tx"), get("ty"), get("tz")) + rotation * glm::dvec3(0, 0, 0.5 * box_height_m)};
}

BoxTrack read_world_box_track_of_tracklet(const pugi::xml_node& tracklet_item,
                                          const std::vector<int>& frame_numbers,
                                          const PoseTrack& world_from_sensor,
                                          const std::string& error_location) {
    BoxTrack track;
    track.category = tracklet_item.child_value("objectType");
    track.size_m = {read_number_field(tracklet_item, "l", error_location),
                    read_number_field(tracklet_item, "w", error_location),
                    read_number_field(tracklet_item, "h", error_location)};
    if (!(std::min({track.size_m.x, track.size_m.y, track.size_m.z}) > 0.0))
        fail("{}: the size of a box is l {} w {} h {} m, expected three lengths above 0", error_location,
             track.size_m.x, track.size_m.y, track.size_m.z);
    int frame = int(read_number_field(tracklet_item, "first_frame", error_location));
    for (const pugi::xml_node& pose : tracklet_item.child("poses").children("item")) {
        const auto matching_frame = std::lower_bound(frame_numbers.begin(), frame_numbers.end(), frame);
        const Pose in_sensor = read_box_pose_in_sensor_frame(
            pose, track.size_m.z, fmt::format("{} frame {}", error_location, frame));
        ++frame;
        if (matching_frame == frame_numbers.end() || *matching_frame != frame - 1) continue;
        const std::size_t at = std::size_t(matching_frame - frame_numbers.begin());
        track.world_from_box.append(world_from_sensor.time_s[at], world_from_sensor.pose[at] * in_sensor);
    }
    return track;
}

}  // namespace

std::vector<BoxTrack> read_tracklet_boxes(const std::filesystem::path& tracklet_file,
                                          const std::vector<int>& frame_numbers,
                                          const PoseTrack& world_from_sensor) {
    if (!does_path_exist(tracklet_file)) return {};
    const std::string text = read_text_file(tracklet_file);
    pugi::xml_document document;
    const pugi::xml_parse_result parsed = document.load_buffer(text.data(), text.size());
    if (!parsed)
        fail("{}: malformed XML at byte {}: {}", tracklet_file.string(), parsed.offset, parsed.description());
    const pugi::xml_node tracklets = document.child("boost_serialization").child("tracklets");
    if (!tracklets)
        fail("{}: the element boost_serialization/tracklets is missing, expected KITTI tracklets",
             tracklet_file.string());
    std::vector<BoxTrack> tracks;
    int number = 0;
    for (const pugi::xml_node& item : tracklets.children("item")) {
        const std::string id = std::to_string(number++);
        BoxTrack track = read_world_box_track_of_tracklet(
            item, frame_numbers, world_from_sensor, fmt::format("{}: track {}", tracklet_file.string(), id));
        track.id = id;
        if (!track.world_from_box.pose.empty()) tracks.push_back(std::move(track));
    }
    return tracks;
}

}  // namespace relidar::kitti
