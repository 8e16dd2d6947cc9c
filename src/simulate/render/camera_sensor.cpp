// SPDX-License-Identifier: Apache-2.0
#include <relidar/simulate/camera.hpp>

#include <algorithm>
#include <cmath>
#include <limits>

#include <relidar/run/stage_options.hpp>

namespace relidar {

RayTable camera_rays(const Camera& camera) {
    RayTable rays;
    rays.rows = camera.rows;
    rays.columns = camera.columns;
    const std::size_t n = std::size_t(camera.rows) * std::size_t(camera.columns);
    rays.origin.assign(n, glm::vec3(0.0f));
    rays.time_offset_s.assign(n, 0.0f);
    for (int row = 0; row < camera.rows; ++row)
        for (int column = 0; column < camera.columns; ++column) {
            rays.direction.emplace_back(camera.direction_of({column, row}));
            rays.channel.push_back(std::uint16_t(row));
        }
    return rays;
}

SimulatedSensor camera_sensor(const Camera& camera, const Config& config, const Log& log, int lidar) {
    return {.rays = camera_rays(camera),
            .limits = {0.0, with_max_range(config, log).dataset.max_range_m},
            .name = camera.name,
            .lidar = lidar,
            .returns = 1,
            .rolling_shutter = false,
            .camera = camera};
}

Image draw_camera(const RenderedScan& scan) {
    const RangeImage& image = scan.image;
    Image picture{image.rows, image.columns, {}};
    picture.rgb.reserve(3 * image.range_m.size());
    for (std::size_t i = 0; i < image.range_m.size(); ++i) {
        const float intensity = is_ray_returned(image.drop_prob[i], image.range_m[i])
                                    ? std::clamp(image.intensity[i], 0.0f, 1.0f)
                                    : 0.0f;
        picture.rgb.insert(picture.rgb.end(), 3, std::uint8_t(std::lround(255.0f * intensity)));
    }
    return picture;
}

DepthImage draw_depth(const RenderedScan& scan) {
    constexpr double kStepsPerMetre = 256.0;
    const RangeImage& image = scan.image;
    const std::vector<float>& range_m = scan.median_range_m;  // not between two surfaces at edges
    DepthImage depth{image.rows, image.columns, std::vector<std::uint16_t>(range_m.size(), 0)};
    for (std::size_t i = 0; i < depth.values.size(); ++i) {
        if (!is_ray_returned(image.drop_prob[i], range_m[i])) continue;
        const double steps = std::round(kStepsPerMetre * double(range_m[i]) * double(image.direction[i].z));
        if (steps <= std::numeric_limits<std::uint16_t>::max()) depth.values[i] = std::uint16_t(steps);
    }
    return depth;
}

}  // namespace relidar
