// SPDX-License-Identifier: Apache-2.0
// Simulates a drive through the synthetic street with two LiDARs that sweep
// simultaneously: the default LiDAR, and a LiDAR that is mounted 1.2 m behind and to the
// left, turned and tilted.
#pragma once

#include <relidar/log/checks.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>

namespace relidar::test {

inline Log make_two_lidar_street(const StreetOptions& options) {
    const Log one = make_street_log(options);
    Log street = one;
    street.lidars[0].name = "front";
    Lidar rear{"rear",
               one.lidars[0].sensor,
               {glm::angleAxis(1.3, glm::dvec3(0, 0, 1)) * glm::angleAxis(0.1, glm::dvec3(1, 0, 0)),
                {-1.2, 0.5, -0.2}}};
    rear.sensor.beams.resize(rear.sensor.beams.size() / 2);  // keeps only the beams of the upper half
    street.lidars.push_back(rear);
    street.frames.clear();
    const RayTable rays = make_rays(rear.sensor);
    const PoseTrack track = street.lidar_track(1);
    for (const Frame& frame : one.frames) {
        street.frames.push_back(frame);
        street.frames.push_back(
            {frame.index, frame.time_s, cast_street_rays(options, rays, track, frame.time_s), 1});
    }
    check_log(street);
    return street;
}

}  // namespace relidar::test
