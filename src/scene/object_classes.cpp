// SPDX-License-Identifier: Apache-2.0
// Maps the class names of datasets to one list of classes.
#include <relidar/scene/labels.hpp>

#include <algorithm>
#include <array>
#include <cctype>

#include <relidar/scene/scene.hpp>

namespace relidar {
namespace {

struct ClassOfWords {
    std::string_view words;
    ObjectClass object_class;
    ObjectKind kind;
};
using enum ObjectClass;
constexpr ObjectKind kVehicle = ObjectKind::vehicle, kCyclist = ObjectKind::cyclist,
                     kPerson = ObjectKind::person;
/// The first row whose words a name contains decides. A construction worker is a
/// pedestrian, a bicycle rack is no bicycle, and a truck trailer is a trailer.
constexpr ClassOfWords kClasses[] = {
    {"pedestrian", pedestrian, kPerson},
    {"person", pedestrian, kPerson},
    {"signaler", pedestrian, kPerson},
    {"rack", other, ObjectKind::other},
    {"motorcycle", motorcycle, kCyclist},
    {"motorcyclist", motorcycle, kCyclist},
    {"bicycle", cyclist, kCyclist},
    {"bicyclist", cyclist, kCyclist},
    {"cyclist", cyclist, kCyclist},
    {"rider", cyclist, kCyclist},
    {"trailer", trailer, kVehicle},
    {"caravan", trailer, kVehicle},
    {"bus", bus, kVehicle},
    {"truck", truck, kVehicle},
    {"large vehicle", truck, kVehicle},
    {"vehicle construction", truck, kVehicle},
    {"construction vehicle", truck, kVehicle},
    {"ambulance", van, kVehicle},
    {"van", van, kVehicle},
    {"tram", other, kVehicle},
    {"train", other, kVehicle},
    {"railed vehicle", other, kVehicle},
    {"vehicle other", other, kVehicle},
    {"other vehicle", other, kVehicle},
    {"car", car, kVehicle},
    {"vehicle", car, kVehicle},
};

/// Returns the words of a name in lower case: " vehicle bus rigid " for
/// "vehicle.bus.rigid".
std::string split_words(std::string_view name) {
    std::string words = " ";
    for (const unsigned char character : name)
        if (std::isalpha(character)) words += char(std::tolower(character));
        else if (words.back() != ' ') words += ' ';
    return words + " ";
}

const ClassOfWords* find_row(std::string_view category) {
    const std::string words = split_words(category);
    const auto row = std::ranges::find_if(kClasses, [&](const ClassOfWords& candidate) {
        return words.find(" " + std::string(candidate.words) + " ") != std::string::npos;
    });
    return row == std::end(kClasses) ? nullptr : &*row;
}

constexpr double kShortestVehicle_m = 3.0;  // minimum length of a vehicle without a class
/// The longest vans have 7.4 m, for example the Mercedes Sprinter.
constexpr double kLongestVan_m = 7.5;
constexpr double kMaxPersonWidth_m = 1.1, kMinPersonHeight_m = 1.2;  // persons and cyclists without a class
constexpr double kMaxPersonLength_m = 1.3, kMaxCyclistLength_m = 2.2;

ObjectClass guess_class(const glm::dvec3& size_m) {
    const double length = std::max(size_m.x, size_m.y), width = std::min(size_m.x, size_m.y);
    if (length > kLongestVan_m) return truck;
    if (length >= kShortestVehicle_m) return car;
    const bool is_narrow_and_tall = width <= kMaxPersonWidth_m && size_m.z >= kMinPersonHeight_m;
    if (!is_narrow_and_tall) return other;
    if (length < kMaxPersonLength_m) return pedestrian;
    return length < kMaxCyclistLength_m ? cyclist : other;
}

ObjectKind kind_of(ObjectClass object_class) {
    switch (object_class) {
        case car:
        case van:
        case truck:
        case bus:
        case trailer: return kVehicle;
        case cyclist:
        case motorcycle: return kCyclist;
        case pedestrian: return kPerson;
        case other: break;
    }
    return ObjectKind::other;
}

}  // namespace

ObjectKind parse_kind(std::string_view category) {
    const ClassOfWords* row = find_row(category);
    return row ? row->kind : ObjectKind::other;
}

const char* name_of(ObjectKind kind) {
    constexpr const char* kKindNames[] = {"vehicle", "cyclist", "person", "other"};
    return kKindNames[static_cast<int>(kind)];
}

const std::vector<std::string>& list_object_classes() {
    static const std::vector<std::string> kNames{"Car",     "Van",        "Truck",      "Bus",  "Trailer",
                                                 "Cyclist", "Motorcycle", "Pedestrian", "Other"};
    return kNames;
}

const std::string& name_of(ObjectClass object_class) {
    return list_object_classes()[static_cast<std::size_t>(object_class)];
}

bool is_discovered(const BoxTrack& box) { return box.category == kDiscoveredCategory; }

ObjectClass class_of(const BoxTrack& box) {
    if (is_discovered(box)) return guess_class(box.size_m);
    const ClassOfWords* row = find_row(box.category);
    return row ? row->object_class : other;
}

ObjectKind guess_kind(const BoxTrack& box) {
    return is_discovered(box) ? kind_of(guess_class(box.size_m)) : parse_kind(box.category);
}

std::string label_of(const BoxTrack& box) { return is_discovered(box) ? "" : box.category; }

}  // namespace relidar
