// SPDX-License-Identifier: Apache-2.0
#include "object_names.hpp"

#include <algorithm>
#include <cctype>

#include <relidar/scene/scene.hpp>

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

}  // namespace relidar::layouts
