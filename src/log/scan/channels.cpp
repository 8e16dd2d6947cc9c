// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/channels.hpp>

#include <algorithm>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"

namespace relidar {

const BasicChannels& get_basic_channels() {
    using enum ChannelJoin;
    static const BasicChannels channels = {
        .range = {.name = "range",
                  .unit = "m",
                  .meaning = "range of the image, as `render.range` defines it",
                  .join = range},
        .median_range = {.name = "median_range",
                         .unit = "m",
                         .meaning = "range at which half of the light is absorbed",
                         .join = range},
        .mean_range = {.name = "mean_range",
                       .unit = "m",
                       .meaning = "mean range of all surfaces that the ray hits",
                       .join = range},
        .intensity = {.name = "intensity", .meaning = "share of reflected light, 0 to 1", .join = intensity},
        .drop_prob = {.name = "drop_prob",
                      .meaning = "probability of no return; a ray below 0.5 is a point",
                      .join = drop,
                      .none = 1.0},
        .weight = {.name = "weight", .meaning = "share of the light that hits surfaces, 0 to 1"},
        .time = {.name = "time",
                 .unit = "s",
                 .meaning = "firing time of the ray, relative to `time_s` of the scan",
                 .of_ray = true},
        .ring = {.name = "ring", .meaning = "number of the beam; 0 is the highest", .of_ray = true},
        .instance = {.name = "instance", .meaning = "0 background, i > 0 an actor, -1 no hit", .none = -1.0},
    };
    return channels;
}

std::vector<ChannelInfo> list_file_channels() {
    const auto& [range, median_range, mean_range, intensity, drop_prob, weight, time, ring, instance] =
        get_basic_channels();
    return {range, median_range, intensity, drop_prob, weight, time, ring, instance};
}

const std::vector<ChannelInfo>& get_optional_channels() {
    static const std::vector<ChannelInfo> channels = {
        {.name = "normal",
         .meaning = "unit normal towards the sensor, in the frame of the points",
         .turns = true,
         .needs_normals = true},
        {.name = "incidence", .meaning = "cosine of the angle between ray and normal", .needs_normals = true},
        {.name = "velocity",
         .unit = "m/s",
         .meaning = "rate at which the range of the surface grows, from the motion of sensor and actor"},
        {.name = "class",
         .meaning = "kind of the surface: 0 unknown, 1 vehicle, 2 cyclist, 3 person, 4 other actor, 5 road, "
                    "6 sidewalk, 7 terrain, 8 other ground, 9 building, 10 fence, 11 vegetation, 12 pole, "
                    "13 sign, 14 structure, 15 object, -1 no hit",
         .none = -1.0},
        {.name = "spread", .unit = "m", .meaning = "distance between mean and median range"},
        {.name = "seen",
         .meaning = "share of the path of the ray that the log observed, 0 to 1",
         .of_ray = true},
        {.name = "surfel_drop_prob",
         .meaning = "`drop_prob` before the ray-drop network",
         .join = ChannelJoin::drop,
         .none = 1.0},
        {.name = "source",
         .meaning = "cause of the point: 0 surface, 1 fog, 2 rain, 3 snow, 4 mirrored by wet ground, 5 sun, "
                    "6 stray light, -1 no return",
         .none = -1.0},
    };
    return channels;
}

std::vector<std::string> list_optional_channels() {
    std::vector<std::string> names;
    for (const ChannelInfo& channel : get_optional_channels()) names.push_back(channel.name);
    return names;
}

std::vector<ChannelInfo> parse_channels(const std::string& names) {
    std::vector<ChannelInfo> wanted;
    for (const std::string& name : split_words(names)) {
        const auto found = std::ranges::find(get_optional_channels(), name, &ChannelInfo::name);
        if (found == get_optional_channels().end()) {
            const std::vector<std::string> known = list_optional_channels();
            throw UsageError(fmt::format("the channel \"{}\" is unknown{}, expected some of {}",
                                         make_excerpt(name), suggest_name(name, known),
                                         fmt::join(known, ", ")));
        }
        if (std::ranges::find(wanted, name, &ChannelInfo::name) == wanted.end()) wanted.push_back(*found);
    }
    return wanted;
}

std::size_t size(const ChannelValues& values) {
    return std::visit([](const auto& v) { return v.size(); }, values);
}

std::vector<ScanChannel> copy_without_values(const std::vector<ScanChannel>& channels) {
    std::vector<ScanChannel> result;
    for (const auto& [info, values, second] : channels)
        result.push_back(
            {info,
             std::visit([](const auto& v) { return ChannelValues(std::decay_t<decltype(v)>{}); }, values)});
    return result;
}

std::vector<ChannelNumber> list_channel_numbers(const std::vector<ScanChannel>& channels,
                                                const std::string& joint) {
    std::vector<ChannelNumber> numbers;
    for (const auto& [info, values, second] : channels) {
        if (std::holds_alternative<std::vector<glm::vec3>>(values))
            for (const char axis : {'x', 'y', 'z'}) numbers.push_back({info.name + joint + axis, false});
        else numbers.push_back({info.name, std::holds_alternative<std::vector<std::int32_t>>(values)});
    }
    return numbers;
}

void append_channel_values(std::string& bytes, const std::vector<ScanChannel>& channels, std::size_t index) {
    for (const ScanChannel& channel : channels)
        std::visit([&](const auto& values) { append(bytes, values[index]); }, channel.values);
}

void append_return_value(ScanChannel& point_channel, const ScanChannel& ray_channel, std::size_t ray,
                         int number) {
    const ChannelInfo& channel = ray_channel.info;
    const auto append_one = [&]<class T>(const std::vector<T>& values) {
        const auto* second = number == 2 && size(ray_channel.second) > 0
                                 ? std::get_if<std::vector<T>>(&ray_channel.second)
                                 : nullptr;
        const T other = second           ? (*second)[ray]
                        : channel.of_ray ? values[ray]
                                         : get_missing_value<T>(channel);
        std::get<std::vector<T>>(point_channel.values).push_back(number == 1 ? values[ray] : other);
    };
    std::visit(append_one, ray_channel.values);
}

void check_channels(const std::vector<ScanChannel>& channels, std::size_t count,
                    const std::string& description) {
    std::set<std::string> taken = {"range_2", "intensity_2", "return", "points", "x", "y", "z"};
    for (const ChannelInfo& basic : list_file_channels()) taken.insert(basic.name);
    for (const auto& [info, values, second] : channels) {
        const bool is_word = !info.name.empty() && std::ranges::all_of(info.name, [](char character) {
            return character == '_' || (character >= 'a' && character <= 'z') ||
                   (character >= '0' && character <= '9');
        });
        if (!is_word)
            throw DataError(fmt::format(
                "channels of {}: the name \"{}\" is invalid, expected lower case letters, digits and _",
                description, make_excerpt(info.name)));
        if (!taken.insert(info.name).second)
            throw DataError(fmt::format("channels of {}: the name {} occurs twice, expected different names",
                                        description, info.name));
        if (size(second) > 0 && !taken.insert(info.name + "_2").second)
            throw DataError(
                fmt::format("channels of {}: the name {}_2 occurs twice, expected different names",
                            description, info.name));
        if (size(values) != count)
            throw DataError(fmt::format("channels of {}: found {} values of {}, expected {}", description,
                                        size(values), info.name, count));
        if (size(second) > 0 && (size(second) != count || second.index() != values.index()))
            throw DataError(fmt::format(
                "channels of {}: found {} values of {} for second returns, expected {} of the same type",
                description, size(second), info.name, count));
    }
}

}  // namespace relidar
