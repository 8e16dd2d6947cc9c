// SPDX-License-Identifier: Apache-2.0
// Visibility of points in the frames of a log, by range images.
#include "scene/visibility.hpp"

#include <algorithm>
#include <cmath>

#include "core/parallel.hpp"

namespace relidar {

namespace {

constexpr int kRows = 64, kColumns = 1024;
constexpr int kMinReturns = 3;   ///< of the 3 x 3 pixels around a point

/// A grid over the sensor's vertical field of view, a beam or so a row.
RangeGrid grid_over(const SpinningSensor& sensor) {
    double low = 1e9, high = -1e9;
    for (const Beam& beam : sensor.beams) {
        low = std::min(low, beam.elevation_rad);
        high = std::max(high, beam.elevation_rad);
    }
    const double margin = 0.02;
    return {"visibility", std::min<int>(kRows, std::max<int>(1, static_cast<int>(sensor.beams.size()))), kColumns, high + margin, high - low + 2.0 * margin, 1e6};
}

/// Nearest and farthest of the returns in the 3 x 3 pixels around each pixel, columns wrapping round.
void filter(const RangeGrid& grid, const std::vector<float>& range, std::vector<float>& nearest, std::vector<float>& farthest) {
    nearest.assign(range.size(), 0.0f);
    farthest.assign(range.size(), 0.0f);
    for (int row = 0; row < grid.rows; ++row)
        for (int column = 0; column < grid.columns; ++column) {
            float low = 1e30f, high = 0.0f;
            int n = 0;
            for (int r = std::max(row - 1, 0); r <= std::min(row + 1, grid.rows - 1); ++r)
                for (int c = column - 1; c <= column + 1; ++c) {
                    const float value = range[std::size_t(r * grid.columns + (c + grid.columns) % grid.columns)];
                    if (!(value > 0.0f)) continue;
                    low = std::min(low, value);
                    high = std::max(high, value);
                    ++n;
                }
            if (n < kMinReturns) continue;
            nearest[std::size_t(row * grid.columns + column)] = low;
            farthest[std::size_t(row * grid.columns + column)] = high;
        }
}

}  // namespace

Visibility::Visibility(const Sequence& sequence, const std::vector<int>& positions) : sequence_(sequence), grid_(grid_over(sequence.sensor)), views_(positions.size()) {
    run_parallel(static_cast<int>(positions.size()), [&](int i) {
        const Frame& frame = sequence_.frames[std::size_t(positions[std::size_t(i)])];
        std::vector<glm::vec3> points;
        for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray)
            if (frame.scan.range_m[ray] > 0.0f) points.push_back(frame.scan.point(ray));
        View& view = views_[std::size_t(i)];
        view.time_s = frame.time_s;
        filter(grid_, project_points(grid_, points, std::vector<float>(points.size(), 0.0f)).range_m, view.nearest_m, view.farthest_m);
    });
}

/// The point in the sensor's frame at the moment the head faces it.
glm::dvec3 Visibility::in_sensor(const View& view, const glm::dvec3& point_m) const {
    const glm::dvec3 p = inverse(sequence_.world_from_sensor.at(view.time_s)) * point_m;
    return inverse(sequence_.world_from_sensor.at(facing_time(sequence_, p, view.time_s))) * point_m;
}

Visibility::Votes Visibility::votes(const glm::vec3& point_m) const {
    Votes votes;
    for (const View& view : views_) {
        const glm::dvec3 p = in_sensor(view, glm::dvec3(point_m));
        const std::optional<int> pixel = project(grid_, p);
        if (!pixel || !(view.nearest_m[std::size_t(*pixel)] > 0.0f)) continue;
        const double range = glm::length(p), margin = 0.3 + 0.02 * range;
        if (view.nearest_m[std::size_t(*pixel)] > range + 2.0 * margin) ++votes.seen_through;
        else if (range > view.nearest_m[std::size_t(*pixel)] - margin && range < view.farthest_m[std::size_t(*pixel)] + margin) ++votes.seen;
    }
    return votes;
}

}  // namespace relidar
