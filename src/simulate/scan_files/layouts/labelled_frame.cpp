// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <cctype>
#include <map>

#include <relidar/scene/labels.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/actor_boxes.hpp>
#include <relidar/simulate/place_points.hpp>

#include "simulate/scan_files/layouts/layout.hpp"
#include "simulate/scan_files/recorded_moment.hpp"

namespace relidar::layouts {
namespace {

struct NamesOfWord {
    const char* word;
    ObjectNames names;
};
/// The first word that a category contains decides, so "caravan" precedes "van".
constexpr NamesOfWord kNamesOfWords[] = {{"caravan", {"Misc", "vehicle.trailer", 20, 259}},
                                         {"trailer", {"Misc", "vehicle.trailer", 20, 259}},
                                         {"bus", {"Misc", "vehicle.bus.rigid", 13, 257}},
                                         {"truck", {"Truck", "vehicle.truck", 18, 258}},
                                         {"large_vehicle", {"Truck", "vehicle.truck", 18, 258}},
                                         {"tram", {"Tram", "vehicle.train", 16, 256}},
                                         {"train", {"Tram", "vehicle.train", 16, 256}},
                                         {"van", {"Van", "vehicle.car", 10, 252}},
                                         {"motorcycl", {"Cyclist", "vehicle.motorcycle", 32, 255}},
                                         {"sitting", {"Person_sitting", "human.pedestrian.adult", 30, 254}}};
/// [ObjectKind] names of categories without such a word
constexpr ObjectNames kNamesOfKinds[] = {{"Car", "vehicle.car", 10, 252},
                                         {"Cyclist", "vehicle.bicycle", 31, 253},
                                         {"Pedestrian", "human.pedestrian.adult", 30, 254},
                                         {"Misc", "other", 99, 259}};

LabelledObject describe_object(const scan_files::ActorInScan& actor, int number, std::size_t n_points) {
    const BoxTrack& box = *actor.box;
    return {.track = box.id,
            .category = label_of(box),
            .object_class = class_of(box),
            .number = number,
            .is_static = actor.is_static,
            .moves = box.is_moving(),
            .size_m = box.size_m,
            .world_from_box = actor.world_from_box(actor.faced_s),
            .n_points = n_points,
            .visible_share = actor.visible_share};
}

/// Returns the objects of the log near the sensors, in the order of their tracks. If
/// several sensors hit an object, its box is the one of the sensor with most points,
/// which it fits best. The visible share is that of the sensor that sees most.
std::vector<LabelledObject> find_objects(std::span<const RenderedScan> scans,
                                         const std::vector<DatasetSensor>& sensors) {
    const ScanOutputOptions& options = sensors.front().options;
    std::vector<std::string> tracks;
    for (const auto* boxes : {&options.actors, &options.standing})
        for (const BoxTrack& box : *boxes) tracks.push_back(box.id);
    std::map<int, scan_files::ActorInScan> best_view;  // by the index of the track
    std::map<int, std::size_t> n_points;               // of all sensors
    for (std::size_t s = 0; s < scans.size(); ++s)
        for (const scan_files::ActorInScan& actor : scan_files::find_actors(scans[s], sensors[s].options)) {
            // An actor with a note is not visible: its points belong to another object.
            if (actor.note != LabelNote::none) continue;
            const int number = int(std::ranges::find(tracks, actor.box->id) - tracks.begin());
            scan_files::ActorInScan& best = best_view.try_emplace(number, actor).first->second;
            n_points[number] += actor.n_points;
            const auto largest_share = std::max(actor.visible_share, best.visible_share);
            if (actor.n_points > best.n_points) best = actor;
            best.visible_share = largest_share;
        }
    std::vector<LabelledObject> objects;
    for (const auto& [number, actor] : best_view)
        objects.push_back(describe_object(actor, number, n_points[number]));
    return objects;
}

}  // namespace

ObjectNames find_object_names(const std::string& category) {
    std::string word = category;
    std::ranges::transform(word, word.begin(), [](unsigned char c) { return char(std::tolower(c)); });
    for (const NamesOfWord& row : kNamesOfWords)
        if (word.find(row.word) != std::string::npos) return row.names;
    return kNamesOfKinds[std::size_t(parse_kind(category))];
}

std::string nuscenes_category(const std::string& category) {
    return category.find('.') == std::string::npos ? find_object_names(category).nuscenes : category;
}

/// Returns the points of all sensors at one time, and the labelled boxes of the objects
/// that at least one point shows.
/// @param index index of the frame in its sequence
LabelledFrame label_frame(std::span<const RenderedScan> scans, const std::vector<DatasetSensor>& sensors,
                          const DatasetView& view, std::size_t index) {
    LabelledFrame frame{.index = index, .time_s = scans[0].time_s};
    frame.stamp_ns = scan_files::to_stamp_ns(frame.time_s, sensors[0].options.time_shift_ns);
    // The rig's pose at the reference time of the first sensor's scan.
    frame.world_from_rig = scans[0].world_from_sensor * inverse(sensors[0].rig_from_sensor);
    const FrameView frame_view(view, frame);
    std::vector<RenderedScan> cut_scans;
    if (view.fov != DatasetFov::all) {
        for (std::size_t s = 0; s < scans.size(); ++s)
            cut_scans.push_back(frame_view.cut_scan(scans[s], sensors[s].options.config));
        scans = cut_scans;
    }
    for (std::size_t s = 0; s < scans.size(); ++s) {
        frame.n_rings.push_back(scans[s].ring.empty() ? 0 : 1 + *std::ranges::max_element(scans[s].ring));
        frame.clouds.push_back(place_points(scans[s], sensors[s].options.config, scans[s].world_from_sensor));
    }
    for (LabelledObject& object : find_objects(scans, sensors)) {
        object.image_box = frame_view.find_image_box(object);
        if (object.n_points > 0 && frame_view.has_label(object)) frame.objects.push_back(std::move(object));
        else if (object.image_box) frame.unlabelled.push_back(*object.image_box);
    }
    std::ranges::copy(frame_view.unlabelled_parts(), std::back_inserter(frame.unlabelled));
    return frame;
}

}  // namespace relidar::layouts
