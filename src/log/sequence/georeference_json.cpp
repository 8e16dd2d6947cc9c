// SPDX-License-Identifier: Apache-2.0
#include "log/sequence/georeference_json.hpp"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/json_field.hpp"

namespace relidar {

nlohmann::ordered_json georeference_json(const Georeference& g) {
    return {{"latitude_deg", g.position.latitude_deg},
            {"longitude_deg", g.position.longitude_deg},
            {"height_m", g.position.height_m},
            {"world_point_m", {g.point_m.x, g.point_m.y, g.point_m.z}},
            {"crs", g.crs},
            {"rotation", {g.rotation.w, g.rotation.x, g.rotation.y, g.rotation.z}}};
}

Georeference read_georeference(const JsonField& field) {
    constexpr double kMaxLength_m = 1e9;
    constexpr std::size_t kMaxCrsBytes = 4096;
    field.check_members({"latitude_deg", "longitude_deg", "height_m", "world_point_m", "crs", "rotation"});
    Georeference g{
        {field.at("latitude_deg").number_in(-90.0, 90.0), field.at("longitude_deg").number_in(-360.0, 360.0),
         field.at("height_m").number_in(-kMaxLength_m, kMaxLength_m)},
        {},
        field.at("crs").short_text(kMaxCrsBytes)};
    field.at("world_point_m").numbers<3>();
    for (int axis = 0; axis < 3; ++axis)
        g.point_m[axis] =
            field.at("world_point_m").at(std::size_t(axis)).number_in(-kMaxLength_m, kMaxLength_m);
    const auto q = field.at("rotation").numbers<4>();
    g.rotation = {q[0], q[1], q[2], q[3]};
    if (std::abs(glm::length(g.rotation) - 1.0) > 1e-6)
        field.at("rotation")
            .reject(fmt::format("found a length of {}", glm::length(g.rotation)),
                    "expected a quaternion w x y z of length 1");
    return g;
}

}  // namespace relidar
