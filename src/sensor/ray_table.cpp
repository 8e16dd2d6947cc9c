// SPDX-License-Identifier: Apache-2.0
// Tables of rays, whatever made them.
#include <relidar/sensor.hpp>

#include <algorithm>

namespace relidar {

double RayTable::largest_divergence() const {
    return ray_divergence_rad.empty() ? divergence_rad : *std::ranges::max_element(ray_divergence_rad);
}

void RayTable::append(const RayTable& from, std::size_t ray) {
    origin.push_back(from.origin[ray]);
    direction.push_back(from.direction[ray]);
    time_offset_s.push_back(from.time_offset_s[ray]);
    channel.push_back(from.channel[ray]);
    divergence_rad = from.divergence_rad;
    if (!from.ray_divergence_rad.empty()) ray_divergence_rad.push_back(from.ray_divergence_rad[ray]);
}

RayTable some_rays(const RayTable& rays, const std::vector<std::size_t>& wanted) {
    RayTable some;
    some.rows = 1;
    some.columns = static_cast<int>(wanted.size());
    for (const std::size_t ray : wanted) some.append(rays, ray);
    return some;
}

}  // namespace relidar
