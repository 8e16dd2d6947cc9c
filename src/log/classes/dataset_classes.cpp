// SPDX-License-Identifier: Apache-2.0
#include "log/classes/dataset_classes.hpp"

#include <algorithm>
#include <span>

namespace relidar {
namespace {

struct ClassNumberMapping {
    int number;
    SurfaceClass surface;
};

/// First characters of a class name in a dataset, and the matching class of relidar.
struct ClassPrefixMapping {
    std::string_view prefix;
    SurfaceClass surface;
};

SurfaceClass find_class_by_number(std::span<const ClassNumberMapping> class_table, int class_number) {
    const auto row = std::ranges::find(class_table, class_number, &ClassNumberMapping::number);
    return row == class_table.end() ? SurfaceClass::unknown : row->surface;
}

}  // namespace

SurfaceClass convert_semantic_kitti_label(int label) {
    using enum SurfaceClass;
    static constexpr ClassNumberMapping kClasses[] = {
        {10, vehicle},       // car
        {11, cyclist},       // bicycle
        {13, vehicle},       // bus
        {15, cyclist},       // motorcycle
        {16, vehicle},       // on-rails
        {18, vehicle},       // truck
        {20, vehicle},       // other-vehicle
        {30, person},        // person
        {31, cyclist},       // bicyclist
        {32, cyclist},       // motorcyclist
        {40, road},          // road
        {44, road},          // parking
        {48, sidewalk},      // sidewalk
        {49, other_ground},  // other-ground
        {50, building},      // building
        {51, fence},         // fence
        {52, structure},     // other-structure
        {60, road},          // lane-marking
        {70, vegetation},    // vegetation
        {71, vegetation},    // trunk
        {72, terrain},       // terrain
        {80, pole},          // pole
        {81, sign},          // traffic-sign
        {99, object},        // other-object
        {252, vehicle},      // moving-car
        {253, cyclist},      // moving-bicyclist
        {254, person},       // moving-person
        {255, cyclist},      // moving-motorcyclist
        {256, vehicle},      // moving-on-rails
        {257, vehicle},      // moving-bus
        {258, vehicle},      // moving-truck
        {259, vehicle},      // moving-other-vehicle
    };
    return find_class_by_number(kClasses, label);
}

SurfaceClass convert_nuscenes_class(std::string_view category) {
    using enum SurfaceClass;
    // the first row whose prefix matches
    static constexpr ClassPrefixMapping kClasses[] = {
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
    const auto* row = std::ranges::find_if(
        kClasses, [&](const ClassPrefixMapping& named) { return category.starts_with(named.prefix); });
    return row == std::end(kClasses) ? unknown : row->surface;
}

SurfaceClass convert_waymo_class(int class_number) {
    using enum SurfaceClass;
    static constexpr ClassNumberMapping kClasses[] = {
        {1, vehicle},        // car
        {2, vehicle},        // truck
        {3, vehicle},        // bus
        {4, vehicle},        // other vehicle
        {5, cyclist},        // motorcyclist
        {6, cyclist},        // bicyclist
        {7, person},         // pedestrian
        {8, sign},           // sign
        {9, sign},           // traffic light
        {10, pole},          // pole
        {11, object},        // construction cone
        {12, cyclist},       // bicycle
        {13, cyclist},       // motorcycle
        {14, building},      // building
        {15, vegetation},    // vegetation
        {16, vegetation},    // tree trunk
        {17, sidewalk},      // kerb
        {18, road},          // road
        {19, road},          // lane marker
        {20, other_ground},  // other ground
        {21, terrain},       // walkable
        {22, sidewalk},      // sidewalk
    };
    return find_class_by_number(kClasses, class_number);
}

}  // namespace relidar
