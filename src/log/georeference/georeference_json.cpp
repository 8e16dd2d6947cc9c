// SPDX-License-Identifier: Apache-2.0
#include "log/georeference/georeference_json.hpp"

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

/// Reads what georeference_json() writes: a position on the earth, the same point in the
/// dataset's world, and the rotation between both.
/// @throws DataError naming the member that is wrong
Georeference read_georeference(const JsonField& field) {
    constexpr double kMaxLength_m = 1e9;
    constexpr std::size_t kMaxCrsBytes = 4096;
    field.check_members({"latitude_deg", "longitude_deg", "height_m", "world_point_m", "crs", "rotation"});
    Georeference g;
    g.position.latitude_deg = field.at("latitude_deg").number_in(-90.0, 90.0);
    g.position.longitude_deg = field.at("longitude_deg").number_in(-360.0, 360.0);
    g.position.height_m = field.at("height_m").number_in(-kMaxLength_m, kMaxLength_m);
    g.crs = field.at("crs").short_text(kMaxCrsBytes);
    g.point_m = field.at("world_point_m").vector_in(-kMaxLength_m, kMaxLength_m);
    const auto wxyz = field.at("rotation").numbers<4>();
    g.rotation = {wxyz[0], wxyz[1], wxyz[2], wxyz[3]};
    if (std::abs(glm::length(g.rotation) - 1.0) > 1e-6)
        field.at("rotation")
            .reject(fmt::format("found a length of {}", glm::length(g.rotation)),
                    "expected a quaternion w x y z of length 1");
    return g;
}

}  // namespace relidar
