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
    const bool is_image = list.is_array() && list.size() > 0 && list.at(std::size_t(0)).is_array() &&
                          list.at(std::size_t(0)).size() > 0 &&
                          list.at(std::size_t(0)).at(std::size_t(0)).is_array();
    return is_image ? std::min(list.size(), kMaxRays) : 1;
}

}  // namespace

SensorModel sensor::parse_ray_table(const JsonField& field, const std::string& default_name) {
    field.check_members({"directions", "origin", "time", "ring", "rows", "divergence", "divergence_mrad",
                         "divergence_rad", "name", "min_range_m", "max_range_m"});
    const auto list = [&](const char* key) {
        return field.has_member(key) ? field.at(key).flat_numbers(kMaxListNesting) : std::vector<double>{};
    };
    sensor_files::RayFileArrays c{.direction = field.at("directions").flat_numbers(kMaxListNesting),
                                  .origin = list("origin"),
                                  .time_s = list("time"),
                                  .channel = list("ring"),
                                  .keeps_floats = true};
    const std::size_t rows = count_ray_rows(field);
    c.rows = int(rows);
    // make_ray_sensor() checks that rows x columns is the number of rays.
    c.columns = int(std::min(c.direction.size() / 3 / rows, kMaxRays));
    std::optional<double> of_all_mrad;
    if (field.has_member("divergence_mrad")) of_all_mrad = field.at("divergence_mrad").number();
    c.divergence_rad = sensor_files::choose_divergence(list("divergence"), of_all_mrad, field.location());
    if (field.has_member("divergence_rad")) c.divergence_rad = {field.at("divergence_rad").number()};
    c.limits = {field.has_member("min_range_m") ? field.at("min_range_m").number() : c.limits.min_m,
                field.has_member("max_range_m") ? field.at("max_range_m").number() : c.limits.max_m};
    return sensor_files::make_ray_sensor(c, field.has_member("name") ? field.at("name").text() : default_name,
                                         field.location());
}

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
