// SPDX-License-Identifier: Apache-2.0
// Implements operations on ray tables. Also chooses the directions of the sub-rays that
// sample the cross-section of a beam.
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <cmath>

#include <relidar/base/math.hpp>

namespace relidar {
double RayTable::max_divergence_rad() const {
    return ray_divergence_rad.empty() ? divergence_rad : *std::ranges::max_element(ray_divergence_rad);
}

void RayTable::append_ray(const RayTable& source_table, std::size_t ray_index) {
    origin.push_back(source_table.origin[ray_index]);
    direction.push_back(source_table.direction[ray_index]);
    time_offset_s.push_back(source_table.time_offset_s[ray_index]);
    channel.push_back(source_table.channel[ray_index]);
    divergence_rad = source_table.divergence_rad;
    if (!source_table.ray_divergence_rad.empty())
        ray_divergence_rad.push_back(source_table.ray_divergence_rad[ray_index]);
}

std::vector<glm::dvec2> spread_sub_rays(int n_sub_rays) {
    constexpr double kGoldenAngle_rad = 2.399963229728653;
    std::vector<glm::dvec2> offsets;
    const auto add_offset = [&](double radius, double angle_rad) {
        offsets.push_back(radius * glm::dvec2(std::cos(angle_rad), std::sin(angle_rad)));
    };
    const auto add_ring = [&](double radius, double first_angle_rad) {
        for (int k = 0; k < 4; ++k) add_offset(radius, first_angle_rad + k * kPi / 2.0);
    };
    if (n_sub_rays != 1 && n_sub_rays != 5 && n_sub_rays != 9) {
        // Spiral of Fermat, which covers a disc evenly.
        for (int k = 0; k < n_sub_rays; ++k)
            add_offset(std::sqrt((k + 0.5) / n_sub_rays), k * kGoldenAngle_rad);
        return offsets;
    }
    // The radii are such that the mean of radius^2 over all sub-rays is 1/2.
    offsets.emplace_back(0.0, 0.0);
    if (n_sub_rays == 5) add_ring(std::sqrt(5.0 / 8.0), 0.0);
    if (n_sub_rays == 9) {
        add_ring(0.5, kPi / 4.0);
        add_ring(std::sqrt(7.0 / 8.0), 0.0);
    }
    return offsets;
}

bool is_full_turn(int rows, int columns, std::span<const glm::vec3> directions) {
    constexpr double kLeastTurn_rad = 350.0 / 180.0 * kPi;
    if (columns < 3 || directions.size() < std::size_t(rows) * std::size_t(columns)) return false;
    // Adds the steps of one row, because first and last column alone cannot tell a narrow
    // image from a full turn.
    const std::span<const glm::vec3> row =
        directions.subspan(std::size_t(rows / 2) * std::size_t(columns), std::size_t(columns));
    const auto azimuth_rad = [&](std::size_t column) {
        return std::atan2(double(row[column].y), double(row[column].x));
    };
    double turned_rad = 0.0;
    for (std::size_t column = 1; column < row.size(); ++column)
        turned_rad += std::remainder(azimuth_rad(column) - azimuth_rad(column - 1), 2.0 * kPi);
    // columns - 1 steps become the full turn of `columns` steps.
    return std::abs(turned_rad) * columns / (columns - 1) >= kLeastTurn_rad;
}

RayTable select_rays(const RayTable& rays, const std::vector<std::size_t>& ray_indices) {
    RayTable some;
    some.rows = 1;
    some.columns = int(ray_indices.size());
    for (const std::size_t ray : ray_indices) some.append_ray(rays, ray);
    return some;
}

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
