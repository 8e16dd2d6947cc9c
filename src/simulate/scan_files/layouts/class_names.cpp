// SPDX-License-Identifier: Apache-2.0
// Names of the classes of objects in data sets.
#include <algorithm>
#include <sstream>

#include <toml++/toml.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "simulate/scan_files/layouts/layout.hpp"

namespace relidar::layouts {
namespace {

/// [ObjectClass]
constexpr ObjectNames kObjectNames[] = {{"Car", "vehicle.car", 10, 252},
                                        {"Van", "vehicle.car", 10, 252},
                                        {"Truck", "vehicle.truck", 18, 258},
                                        {"Misc", "vehicle.bus.rigid", 13, 257},
                                        {"Misc", "vehicle.trailer", 20, 259},
                                        {"Cyclist", "vehicle.bicycle", 31, 253},
                                        {"Cyclist", "vehicle.motorcycle", 32, 255},
                                        {"Pedestrian", "human.pedestrian.adult", 30, 254},
                                        {"Misc", "movable_object.debris", 99, 259}};
/// Names of nuScenes that OpenPCDet knows. It fails on any other.
constexpr std::string_view kNuscenesNames[] = {"animal",
                                               "human.pedestrian.adult",
                                               "human.pedestrian.child",
                                               "human.pedestrian.construction_worker",
                                               "human.pedestrian.personal_mobility",
                                               "human.pedestrian.police_officer",
                                               "human.pedestrian.stroller",
                                               "human.pedestrian.wheelchair",
                                               "movable_object.barrier",
                                               "movable_object.debris",
                                               "movable_object.pushable_pullable",
                                               "movable_object.trafficcone",
                                               "static_object.bicycle_rack",
                                               "vehicle.bicycle",
                                               "vehicle.bus.bendy",
                                               "vehicle.bus.rigid",
                                               "vehicle.car",
                                               "vehicle.construction",
                                               "vehicle.emergency.ambulance",
                                               "vehicle.emergency.police",
                                               "vehicle.motorcycle",
                                               "vehicle.trailer",
                                               "vehicle.truck"};
/// Names of KITTI that no class has.
constexpr const char* kMoreKittiNames[] = {"Tram", "Person_sitting"};

std::string choose_name(const std::string& layout, const LabelledObject& object, const ClassNames& chosen) {
    for (const std::string& key : {object.label, name_of(object.object_class)})
        if (const auto name = chosen.find(key); name != chosen.end()) return name->second;
    if (layout == "custom") return name_of(object.object_class);
    const ObjectNames& names = find_object_names(object.object_class);
    if (layout == "nuscenes")
        return std::ranges::count(kNuscenesNames, object.label) > 0 ? object.label : names.nuscenes;
    return std::ranges::count(kMoreKittiNames, object.label) > 0 ? object.label : names.kitti;
}

}  // namespace

const ObjectNames& find_object_names(ObjectClass object_class) {
    return kObjectNames[static_cast<std::size_t>(object_class)];
}

void name_objects(LabelledFrame& frame, const std::string& layout, const ClassNames& chosen) {
    for (LabelledObject& object : frame.objects) object.name = choose_name(layout, object, chosen);
    const auto is_unnamed = [](const LabelledObject& object) { return object.name.empty(); };
    for (const LabelledObject& object : frame.objects)
        if (is_unnamed(object) && object.image_box) frame.unlabelled.push_back(*object.image_box);
    std::erase_if(frame.objects, is_unnamed);
}

}  // namespace relidar::layouts

namespace relidar {

ClassNames read_class_names(const std::filesystem::path& path) {
    const std::string file = path.string(), text = read_text_file(path);
    nlohmann::json json;
    if (path.extension() != ".toml") {
        json = parse_json(text, file);
    } else {
        try {
            std::ostringstream stream;
            stream << toml::json_formatter(toml::parse(text, file));
            json = nlohmann::json::parse(stream.str());
        } catch (const toml::parse_error& error) {
            fail("{}, line {}: {}", file, error.source().begin.line, error.description());
        }
    }
    if (!json.is_object())
        fail("{}: found no pairs of names, expected for example {{\"Van\": \"Car\"}}", file);
    const JsonField root(json, file, "");
    ClassNames names;
    for (const auto& [label, name] : json.items()) {
        names[label] = root.at(label).short_text(100);
        if (names[label].find_first_of(" \t") != std::string::npos)
            root.at(label).reject(fmt::format("found \"{}\"", names[label]),
                                  "expected a name without spaces");
    }
    return names;
}

}  // namespace relidar
