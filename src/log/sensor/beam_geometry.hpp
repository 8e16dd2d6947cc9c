// SPDX-License-Identifier: Apache-2.0
// Computes many rays of a beam. The sines and cosines that all rays of the beam share are
// computed once.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar {

/// Computes the rays of one beam at many azimuths of the head.
class BeamRays {
public:
    explicit BeamRays(const Beam& beam)
        : beam_(beam),
          cos_elevation_(std::cos(beam.elevation_rad)),
          sin_elevation_(std::sin(beam.elevation_rad)),
          left_of_axis_m_(beam.origin_left_m - beam.origin_offset_m * std::sin(beam.azimuth_offset_rad)) {}

    /// The origin is the sum of three offsets: along the head direction, up from the
    /// beam, and to its left.
    BeamRay compute_ray(double head_azimuth_rad) const {
        const double azimuth = head_azimuth_rad + beam_.azimuth_offset_rad;
        const double c = std::cos(azimuth), s = std::sin(azimuth);
        const double ce = cos_elevation_, se = sin_elevation_;
        // Horizontal part of the last two offsets, along the beam and to its left.
        const double forward = -beam_.origin_up_m * se, left = beam_.origin_left_m;
        BeamRay ray;
        ray.origin_m = glm::dvec3(beam_.origin_offset_m * std::cos(head_azimuth_rad) + forward * c - left * s,
                                  beam_.origin_offset_m * std::sin(head_azimuth_rad) + forward * s + left * c,
                                  beam_.origin_up_m * ce);
        ray.direction = glm::dvec3(ce * c, ce * s, se);
        return ray;
    }

    double azimuth_facing(const glm::dvec3& point_m) const {
        const double reach = std::max(std::hypot(point_m.x, point_m.y), 1e-3);
        return std::atan2(point_m.y, point_m.x) - std::asin(glm::clamp(left_of_axis_m_ / reach, -1.0, 1.0)) -
               beam_.azimuth_offset_rad;
    }

private:
    Beam beam_;
    double cos_elevation_, sin_elevation_;
    double left_of_axis_m_;  ///< horizontal distance between the beam and the axis of rotation
};

inline std::vector<BeamRays> make_generators(const std::vector<Beam>& beams) {
    return {beams.begin(), beams.end()};
}

/// Returns a sensor whose rays pass through the pixels of a grid, as project_to_pixel()
/// defines them: it has a beam for each row, and column 0 faces backward.
SpinningSensor make_grid_sensor(const RangeImageGrid& grid);

}  // namespace relidar
