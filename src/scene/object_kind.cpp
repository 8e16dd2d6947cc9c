// SPDX-License-Identifier: Apache-2.0
// Maps the class names of datasets to a few kinds of objects. The datasets are KITTI,
// KITTI-360, Waymo, Argoverse 2 and nuScenes. One table serves all datasets, because a
// shared class name has the same meaning in each of them.
#include <relidar/scene/scene.hpp>

#include <cctype>

namespace relidar {
namespace {

constexpr std::string_view kVehicleClasses[] = {
    // KITTI, KITTI-360, Waymo
    "car", "van", "truck", "tram", "bus", "trailer", "caravan", "train", "vehicle",
    // Argoverse 2
    "regular_vehicle", "large_vehicle", "box_truck", "truck_cab", "vehicular_trailer", "school_bus",
    "articulated_bus", "message_board_trailer", "railed_vehicle", "traffic_light_trailer",
    // nuScenes
    "vehicle.car", "vehicle.truck", "vehicle.trailer", "vehicle.construction", "vehicle.bus.bendy",
    "vehicle.bus.rigid", "vehicle.emergency.ambulance", "vehicle.emergency.police",
    // TruckScenes, Lyft
    "vehicle.other", "vehicle.ego_trailer", "vehicle.train", "other_vehicle", "emergency_vehicle"};
constexpr std::string_view kCyclistClasses[] = {"cyclist",       "bicycle",         "motorcycle",
                                                "rider",         "bicyclist",       "motorcyclist",
                                                "wheeled_rider", "vehicle.bicycle", "vehicle.motorcycle"};
constexpr std::string_view kPersonClasses[] = {"pedestrian",
                                               "person",
                                               "person (sitting)",
                                               "person_sitting",
                                               "official_signaler",
                                               "human.pedestrian.adult",
                                               "human.pedestrian.child",
                                               "human.pedestrian.construction_worker",
                                               "human.pedestrian.police_officer",
                                               "human.pedestrian.personal_mobility",
                                               "human.pedestrian.stroller",
                                               "human.pedestrian.wheelchair"};

bool is_word_in_list(std::span<const std::string_view> words, std::string_view word) {
    return std::ranges::find(words, word) != words.end();
}

}  // namespace

ObjectKind parse_kind(std::string_view category) {
    std::string word(category);
    std::ranges::transform(word, word.begin(),
                           [](unsigned char character) { return char(std::tolower(character)); });
    if (is_word_in_list(kVehicleClasses, word)) return ObjectKind::vehicle;
    if (is_word_in_list(kCyclistClasses, word)) return ObjectKind::cyclist;
    return is_word_in_list(kPersonClasses, word) ? ObjectKind::person : ObjectKind::other;
}

const char* name_of(ObjectKind kind) {
    constexpr const char* kKindNames[] = {"vehicle", "cyclist", "person", "other"};
    return kKindNames[static_cast<int>(kind)];
}

}  // namespace relidar
