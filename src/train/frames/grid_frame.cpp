// SPDX-License-Identifier: Apache-2.0
#include "train/frames/grid_frame.hpp"

namespace relidar {

Frame frame_to_grid(const Log& sequence, const Frame& frame, const RangeImageGrid& grid) {
    constexpr double kGridPeriod_s = 0.1;  // sweep duration that make_rays() assumes for a grid
    const Scan& scan = frame.scan;
    std::vector<glm::vec3> points;
    std::vector<float> intensity;
    std::vector<std::size_t> rays;
    for (std::size_t i = 0; i < scan.range_m.size(); ++i) {
        if (!(scan.range_m[i] > 0.0f)) continue;
        points.push_back(scan.return_point(i));
        intensity.push_back(scan.intensity[i]);
        rays.push_back(i);
    }
    const ProjectedRangeImage image = project_points(grid, points, intensity);
    Frame result = strip_scan(frame);
    result.scan.rays = make_rays(grid);
    result.scan.range_m.assign(image.range_m.begin(), image.range_m.end());
    result.scan.intensity.assign(image.intensity.begin(), image.intensity.end());
    const auto period_ratio = static_cast<float>(sequence.lidar_of(frame).sweep_period_s() / kGridPeriod_s);
    for (std::size_t cell = 0; cell < image.source.size(); ++cell) {
        float& time_s = result.scan.rays.time_offset_s[cell];
        time_s *= period_ratio;
        if (image.source[cell] < 0) continue;
        const std::size_t ray = rays[std::size_t(image.source[cell])];
        time_s = scan.rays.time_offset_s[ray];
        result.scan.rays.channel[cell] = scan.rays.channel[ray];
    }
    return result;
}

}  // namespace relidar
