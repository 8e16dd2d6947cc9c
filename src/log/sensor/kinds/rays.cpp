// SPDX-License-Identifier: Apache-2.0
// Reads and writes sensors of the kind "rays", which are tables of arbitrary rays.
#include <algorithm>

#include "log/sensor/pattern_kinds.hpp"
#include "log/sensor_files/ray_arrays.hpp"

namespace relidar {
namespace {

constexpr int kMaxListNesting = 3;  // maximum nesting of lists: rows, columns, vectors

nlohmann::ordered_json vectors_json(const ScanArray<glm::vec3>& vectors) {
    auto json = nlohmann::ordered_json::array();
    for (const glm::vec3& v : vectors) {
        json.push_back(v.x);
        json.push_back(v.y);
        json.push_back(v.z);
    }
    return json;
}

/// Returns the member `rows`, or the length of the outer list of nested directions, or 1.
std::size_t count_ray_rows(const JsonField& field) {
    if (field.has_member("rows")) return std::size_t(field.at("rows").integer_in(1, std::int64_t(kMaxRays)));
    const JsonField list = field.at("directions");
    constexpr std::size_t kFirst = 0;  // a plain 0 could also be a key
    const auto is_filled_list = [](const JsonField& value) { return value.is_array() && value.size() > 0; };
    // An image is a list of rows, which are lists of vectors.
    const bool is_image =
        is_filled_list(list) && is_filled_list(list.at(kFirst)) && list.at(kFirst).at(kFirst).is_array();
    return is_image ? std::min(list.size(), kMaxRays) : 1;
}

}  // namespace

/// Reads a table of rays, with the array names of a rendered scan. Lists may be nested.
SensorModel sensor::parse_ray_table(const JsonField& field, const std::string& default_name) {
    field.check_members({"directions", "origin", "time", "ring", "rows", "divergence", "divergence_mrad",
                         "divergence_rad", "name", "min_range_m", "max_range_m"});
    const auto read_list = [&](const char* key) {
        return field.has_member(key) ? field.at(key).flat_numbers(kMaxListNesting) : std::vector<double>{};
    };
    const auto read_number = [&](const char* key, double default_value) {
        return field.has_member(key) ? field.at(key).number() : default_value;
    };
    // Keeps directions of length 1 to the bit, because relidar writes such objects.
    sensor_files::RayFileArrays arrays{.direction = field.at("directions").flat_numbers(kMaxListNesting),
                                       .origin = read_list("origin"),
                                       .time_s = read_list("time"),
                                       .channel = read_list("ring"),
                                       .keeps_floats = true};
    const std::size_t rows = count_ray_rows(field);
    arrays.rows = int(rows);
    // make_ray_sensor() checks that rows x columns is the number of rays.
    arrays.columns = int(std::min(arrays.direction.size() / 3 / rows, kMaxRays));
    // Either one value for each ray, or one value for all rays, in one of two units.
    std::optional<double> common_mrad;
    if (field.has_member("divergence_mrad")) common_mrad = field.at("divergence_mrad").number();
    arrays.divergence_rad =
        sensor_files::choose_divergence(read_list("divergence"), common_mrad, field.location());
    if (field.has_member("divergence_rad")) arrays.divergence_rad = {field.at("divergence_rad").number()};
    arrays.limits = {read_number("min_range_m", arrays.limits.min_m),
                     read_number("max_range_m", arrays.limits.max_m)};
    const std::string name = field.has_member("name") ? field.at("name").text() : default_name;
    return sensor_files::make_ray_sensor(arrays, name, field.location());
}

/// Writes the members that parse_ray_table() reads. Leaves out name and range limits.
nlohmann::ordered_json sensor::write(const RayTable& rays) {
    nlohmann::ordered_json json = {{"rows", rays.rows},
                                   {"directions", vectors_json(rays.direction)},
                                   {"origin", vectors_json(rays.origin)},
                                   {"time", rays.time_offset_s},
                                   {"ring", rays.channel}};
    if (rays.ray_divergence_rad.empty()) json["divergence_rad"] = rays.divergence_rad;
    else json["divergence"] = rays.ray_divergence_rad;
    return json;
}

ScanPatternSummary sensor::describe(const RayTable& rays) { return {.n_rays = rays.size()}; }

}  // namespace relidar
