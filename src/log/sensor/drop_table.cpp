// SPDX-License-Identifier: Apache-2.0
// Looks up the probability that the sensor itself drops a ray, by beam and azimuth.
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <cmath>

#include <relidar/base/math.hpp>

namespace relidar {

std::size_t RayDropTable::index_of(std::uint16_t channel, const glm::vec3& direction) const {
    // Bin 0 begins at +180 degrees; bins continue clockwise, like columns.
    const double revolution_fraction =
        (1.0 - std::atan2(double(direction.y), double(direction.x)) / kPi) / 2.0;
    const int bin = std::clamp(int(revolution_fraction * bins), 0, bins - 1);
    return std::size_t(channel) * std::size_t(bins) + std::size_t(bin);
}

float RayDropTable::probability_of(std::uint16_t channel, const glm::vec3& direction) const {
    return empty() || channel >= channels ? 0.0f : probability[index_of(channel, direction)];
}

}  // namespace relidar
