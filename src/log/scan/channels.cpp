// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/channels.hpp>

#include <algorithm>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>

#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"

namespace relidar {

/// Returns the channels that every rendered scan can have: name, unit, meaning, how the
/// values of sub-rays are joined, and the value of a missing return.
const BasicChannels& basic_channels() {
    using enum ChannelMergeRule;
    // join: how the values of the sub-rays of a beam become one value. of_ray: all
    // returns of a ray have the same value. none: the value of a ray without a return.
    static const BasicChannels channels = {
        .range = {.name = "range",
                  .unit = "m",
                  .meaning = "range of the ray in metres, as the setting `render.range` defines it",
                  .join = range},
        .median_range = {.name = "median_range",
                         .unit = "m",
                         .meaning = "range at which half of the light is absorbed",
                         .join = range},
        .mean_range = {.name = "mean_range",
                       .unit = "m",
                       .meaning = "mean range of all surfaces that the ray hits",
                       .join = range},
        .intensity = {.name = "intensity",
                      .meaning = "fraction of light that returns to the sensor, 0 to 1",
                      .join = intensity},
        .drop_prob =
            {.name = "drop_prob",
             .meaning =
                 "probability that the ray has no return; a ray with a value below 0.5 becomes a point",
             .join = drop,
             .none = 1.0},
        .weight = {.name = "weight",
                   .meaning = "fraction of the light of the ray that hits surfaces, 0 to 1"},
        .time = {.name = "time",
                 .unit = "s",
                 .meaning = "firing time of the ray, relative to `time_s` of the scan",
                 .of_ray = true},
        .ring = {.name = "ring", .meaning = "number of the beam; beam 0 is the highest", .of_ray = true},
        .instance =
            {.name = "instance",
             .meaning =
                 "index of the hit object: 0 background, above 0 an actor, -1 no hit, -2 the own vehicle",
             .none = -1.0},
    };
    return channels;
}

std::vector<ChannelInfo> file_channels() {
    const auto& [range, median_range, mean_range, intensity, drop_prob, weight, time, ring, instance] =
        basic_channels();
    return {range, median_range, intensity, drop_prob, weight, time, ring, instance};
}

const std::vector<ChannelInfo>& optional_channels() {
    // turns: a direction that rotates with the frame of the points. needs_normals: not
    // for 3D Gaussians, which have no normals. of_ray: equal for all returns of a ray.
    // join: how the values of sub-rays become one. none: the value without a return.
    static const std::vector<ChannelInfo> channels = {
        {.name = "normal",
         .meaning = "unit normal towards the sensor, in the frame of the points",
         .turns = true,
         .needs_normals = true},
        {.name = "incidence",
         .meaning = "cosine of the angle between the ray and the normal of the surface",
         .needs_normals = true},
        {.name = "velocity",
         .unit = "m/s",
         .meaning = "rate at which the range of the surface grows, from the motion of sensor and actor"},
        {.name = "class",
         .meaning = "kind of the surface: 0 unknown, 1 vehicle, 2 cyclist, 3 person, 4 other actor, 5 road, "
                    "6 sidewalk, 7 terrain, 8 other ground, 9 building, 10 fence, 11 vegetation, 12 pole, 13 "
                    "sign, 14 structure, 15 object, 16 the own vehicle, -1 no hit",
         .none = -1.0},
        {.name = "spread", .unit = "m", .meaning = "distance between mean and median range"},
        {.name = "seen",
         .meaning = "fraction of the path of the ray that the log observed, 0 to 1",
         .of_ray = true},
        {.name = "surfel_drop_prob",
         .meaning = "`drop_prob` before the ray-drop network",
         .join = ChannelMergeRule::drop,
         .none = 1.0},
        {.name = "source",
         .meaning = "cause of the point: 0 surface, 1 fog, 2 rain, 3 snow, 4 mirrored by wet ground, 5 sun, "
                    "6 stray light, -1 no return",
         .none = -1.0},
    };
    return channels;
}

std::vector<std::string> optional_names() {
    std::vector<std::string> names;
    for (const ChannelInfo& channel : optional_channels()) names.push_back(channel.name);
    return names;
}

std::vector<ChannelInfo> parse_channels(const std::string& comma_separated_names) {
    std::vector<ChannelInfo> requested_channels;
    for (const std::string& name : split_list(comma_separated_names)) {
        const auto matching_channel = std::ranges::find(optional_channels(), name, &ChannelInfo::name);
        if (matching_channel == optional_channels().end()) {
            const std::vector<std::string> channel_names = optional_names();
            fail<UsageError>("the channel \"{}\" is unknown{}, expected some of {}", quote(name),
                             did_you_mean(name, channel_names), fmt::join(channel_names, ", "));
        }
        if (std::ranges::find(requested_channels, name, &ChannelInfo::name) == requested_channels.end())
            requested_channels.push_back(*matching_channel);
    }
    return requested_channels;
}

std::size_t count_values(const ChannelValues& values) {
    return std::visit([](const auto& v) { return v.size(); }, values);
}

std::vector<ScanChannel> copy_layout(const std::vector<ScanChannel>& channels) {
    std::vector<ScanChannel> result;
    for (const auto& [info, values, second] : channels)
        result.push_back(
            {info,
             std::visit([](const auto& v) { return ChannelValues(std::decay_t<decltype(v)>{}); }, values)});
    return result;
}

std::vector<ChannelColumn> list_columns(const std::vector<ScanChannel>& channels,
                                        const std::string& axis_separator) {
    std::vector<ChannelColumn> columns;
    for (const auto& [info, values, second] : channels) {
        const bool is_vector = std::holds_alternative<std::vector<glm::vec3>>(values);
        const bool is_integer = std::holds_alternative<std::vector<std::int32_t>>(values);
        if (!is_vector) columns.push_back({info.name, is_integer});
        else
            for (const char axis : {'x', 'y', 'z'})
                columns.push_back({info.name + axis_separator + axis, is_integer});
    }
    return columns;
}

void append_values(std::string& output_bytes, const std::vector<ScanChannel>& channels, std::size_t index) {
    for (const ScanChannel& channel : channels)
        std::visit([&](const auto& values) { append_raw(output_bytes, values[index]); }, channel.values);
}

void append_return(ScanChannel& points, const ScanChannel& rays, std::size_t ray, int return_number_from_1) {
    const bool is_first = return_number_from_1 == 1;
    const bool has_second_values = count_values(rays.second) > 0;
    // T is the type of the values: a number or a vector.
    const auto append_value = [&]<class T>(const std::vector<T>& first_values) {
        auto& point_values = std::get<std::vector<T>>(points.values);
        if (!is_first && has_second_values)
            point_values.push_back(std::get<std::vector<T>>(rays.second)[ray]);
        else if (is_first || rays.info.of_ray) point_values.push_back(first_values[ray]);
        else point_values.push_back(empty_value<T>(rays.info));
    };
    std::visit(append_value, rays.values);
}

namespace {

/// Fails if the name of a channel is not a word, or if another column has it, too.
/// @param used_names  names of the other columns; the name is added
void check_channel_name(const ScanChannel& channel, const std::string& element,
                        std::set<std::string>& used_names) {
    const std::string& name = channel.info.name;
    const auto is_allowed = [](char character) {
        return character == '_' || (character >= 'a' && character <= 'z') ||
               (character >= '0' && character <= '9');
    };
    if (name.empty() || !std::ranges::all_of(name, is_allowed))
        fail("channels of {}: the name \"{}\" is invalid, expected lower case letters, digits and _", element,
             quote(name));
    if (!used_names.insert(name).second)
        fail("channels of {}: the name {} occurs twice, expected different names", element, name);
    if (count_values(channel.second) > 0 && !used_names.insert(name + "_2").second)
        fail(
            "channels of {0}: the name {1}_2 occurs twice, because the second returns of the channel {1} "
            "are stored under this name; rename one of the two channels",
            element, name);
}

}  // namespace

void check_channels(const std::vector<ScanChannel>& channels, std::size_t size, const std::string& element) {
    // Names of other columns in the files.
    std::set<std::string> used_names = {"range_2", "intensity_2", "return", "points", "x", "y", "z"};
    for (const ChannelInfo& basic : file_channels()) used_names.insert(basic.name);
    for (const ScanChannel& channel : channels) {
        check_channel_name(channel, element, used_names);
        const std::size_t n_values = count_values(channel.values), n_second = count_values(channel.second);
        if (n_values != size)
            fail("channels of {}: the channel {} has {} values, expected {}, one for each ray or point",
                 element, channel.info.name, n_values, size);
        // index() is the type of the values: floats, integers or vectors.
        const bool has_same_type = channel.second.index() == channel.values.index();
        if (n_second > 0 && (n_second != size || !has_same_type))
            fail(
                "channels of {}: the channel {} has {} values{} for second returns, expected {} values of "
                "the same type as its values for first returns",
                element, channel.info.name, n_second, has_same_type ? "" : " of another type", size);
    }
}

}  // namespace relidar
