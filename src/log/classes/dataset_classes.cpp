// SPDX-License-Identifier: Apache-2.0
#include "log/classes/dataset_classes.hpp"

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

namespace relidar {
namespace {

/// Numbers of classes in a dataset that are one class of relidar.
struct ClassNumbers {
    SurfaceClass surface;
    std::vector<int> numbers;
};

SurfaceClass find_by_number(const std::vector<ClassNumbers>& classes, int number) {
    for (const auto& [surface, numbers] : classes)
        if (std::ranges::find(numbers, number) != numbers.end()) return surface;
    return SurfaceClass::unknown;
}

}  // namespace

/// Returns the class of a label of SemanticKITTI, or `unknown`.
SurfaceClass from_semantic_kitti(int label) {
    using enum SurfaceClass;
    // Labels from 252 are moving objects.
    static const std::vector<ClassNumbers> kClasses{
        {road, {40, 44, 60}},                                      // road, parking, lane-marking
        {vegetation, {70, 71}},                                    // vegetation, trunk
        {building, {50}},                                          // building
        {terrain, {72}},                                           // terrain
        {sidewalk, {48}},                                          // sidewalk
        {vehicle, {10, 13, 16, 18, 20, 252, 256, 257, 258, 259}},  // car, bus, on-rails, truck, other
        {other_ground, {49}},                                      // other-ground
        {fence, {51}},                                             // fence
        {structure, {52}},                                         // other-structure
        {pole, {80}},                                              // pole
        {sign, {81}},                                              // traffic-sign
        {object, {99}},                                            // other-object
        {person, {30, 254}},                                       // person
        {cyclist, {11, 15, 31, 32, 253, 255}},                     // bicycle, motorcycle, and their riders
    };
    return find_by_number(kClasses, label);
}

int to_semantic_kitti(SurfaceClass surface) {
    static const std::array<int, kSurfaceClasses> kLabels = [] {
        std::array<int, kSurfaceClasses> labels{};
        for (int label = 99; label >= 0; --label) labels[std::size_t(from_semantic_kitti(label))] = label;
        return labels;
    }();
    return kLabels[std::size_t(surface)];
}

/// Returns the class of a nuScenes category: the first prefix that matches, or `unknown`.
SurfaceClass from_nuscenes(std::string_view category) {
    using enum SurfaceClass;
    static constexpr std::pair<std::string_view, SurfaceClass> kClasses[] = {
        {"vehicle.ego", unknown},
        {"vehicle.bicycle", cyclist},
        {"vehicle.motorcycle", cyclist},
        {"vehicle.", vehicle},
        {"human.", person},
        {"animal", other_actor},
        {"flat.driveable_surface", road},
        {"flat.sidewalk", sidewalk},
        {"flat.terrain", terrain},
        {"flat.", other_ground},
        {"static.manmade", structure},
        {"static.vegetation", vegetation},
        {"static", object},
        {"movable_object.", object},
    };
    for (const auto& [prefix, surface] : kClasses)
        if (category.starts_with(prefix)) return surface;
    return unknown;
}

/// Returns the class of a number of Waymo's 3D segmentation labels, or `unknown`.
SurfaceClass from_waymo(int class_number) {
    using enum SurfaceClass;
    static const std::vector<ClassNumbers> kClasses{
        {vehicle, {1, 2, 3, 4}},    // car, truck, bus, other vehicle
        {road, {18, 19}},           // road, lane marker
        {building, {14}},           // building
        {vegetation, {15, 16}},     // vegetation, tree trunk
        {sidewalk, {17, 22}},       // kerb, sidewalk
        {other_ground, {20}},       // other ground
        {terrain, {21}},            // walkable
        {cyclist, {5, 6, 12, 13}},  // motorcyclist, bicyclist, bicycle, motorcycle
        {person, {7}},              // pedestrian
        {sign, {8, 9}},             // sign, traffic light
        {pole, {10}},               // pole
        {object, {11}},             // construction cone
    };
    return find_by_number(kClasses, class_number);
}

}  // namespace relidar
