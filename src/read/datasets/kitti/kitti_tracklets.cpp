// SPDX-License-Identifier: Apache-2.0
// Reads tracklet_labels.xml, a boost archive. Each item is an object with one pose per
// frame, beginning at first_frame. A pose is in the sensor frame at the time when the
// head faces forward. The position in the file is the centre of the box's bottom face, so
// centre = t + R (0, 0, h/2).
#include "base/fail.hpp"
#include "read/datasets/kitti/log_files.hpp"

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
double read_tracklet_number(const pugi::xml_node& node, const char* name, const std::string& where) {
    const std::string text = node.child_value(name);
    const auto value = parse_number(trim(text));
    if (!value || !(std::abs(*value) <= kLargestOfLabel))
        fail("{}: {} is '{}', expected a finite number of at most {:.0e}", where, name, quote(text),
             kLargestOfLabel);
    return *value;
}

/// Reads a pose of a box. The file has the centre of its bottom, the result its centre.
Pose read_box_pose(const pugi::xml_node& pose_item, double box_height_m, const std::string& where) {
    const auto get = [&](const char* field) { return read_tracklet_number(pose_item, field, where); };
    const glm::dquat rotation = make_rotation(get("rz"), get("ry"), get("rx"));
    return {rotation,
            glm::dvec3(get("tx"), get("ty"), get("tz")) + rotation * glm::dvec3(0, 0, 0.5 * box_height_m)};
}

/// Reads the track of one object (tracklet), without its id. The file has sensor-frame
/// poses for consecutive frames from first_frame on. Skips frames that are not loaded.
/// @param numbers  [poses of world_from_sensor] numbers of the loaded frames, sorted
BoxTrack read_tracklet(const pugi::xml_node& tracklet_item, const std::vector<int>& numbers,
                       const PoseTrack& world_from_sensor, const std::string& where) {
    BoxTrack track;
    track.category = tracklet_item.child_value("objectType");
    track.size_m = {read_tracklet_number(tracklet_item, "l", where),
                    read_tracklet_number(tracklet_item, "w", where),
                    read_tracklet_number(tracklet_item, "h", where)};
    int next_frame = int(read_tracklet_number(tracklet_item, "first_frame", where));
    for (const pugi::xml_node& pose : tracklet_item.child("poses").children("item")) {
        const int frame = next_frame++;
        const Pose sensor_from_box =
            read_box_pose(pose, track.size_m.z, fmt::format("{} frame {}", where, frame));
        const auto entry = std::ranges::lower_bound(numbers, frame);
        if (entry == numbers.end() || *entry != frame) continue;
        const std::size_t i = std::size_t(entry - numbers.begin());
        track.world_from_box.append(world_from_sensor.time_s[i], world_from_sensor.pose[i] * sensor_from_box);
    }
    return track;
}

}  // namespace

std::vector<BoxTrack> read_tracklets(const std::filesystem::path& tracklet_file,
                                     const std::vector<int>& numbers, const PoseTrack& world_from_sensor) {
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
        // KITTI's tracklets have no ids, so the position in the file is the id.
        const std::string id = std::to_string(number++);
        BoxTrack track = read_tracklet(item, numbers, world_from_sensor,
                                       fmt::format("{}: track {}", tracklet_file.string(), id));
        track.id = id;
        if (!track.world_from_box.pose.empty()) tracks.push_back(std::move(track));
    }
    return tracks;
}

}  // namespace relidar::kitti
