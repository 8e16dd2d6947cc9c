// SPDX-License-Identifier: Apache-2.0
// Pictures of a camera. A camera is rendered by ScanRenderer like a LiDAR, with a ray
// through the centre of each pixel.
#pragma once

#include <relidar/base/images.hpp>
#include <relidar/log/camera.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Returns a ray through the centre of each pixel, in the frame of the camera: x right, y
/// down, z forward. All rays start at the camera at the time of the picture. `channel` is
/// the row of the pixel.
RayTable camera_rays(const Camera& camera);
/// Returns a sensor whose scans are pictures of a camera. Its frame is the frame of the
/// camera, so `offset * camera.rig_from_camera` mounts it. A pixel shows the surfaces of
/// the scene, without the beams, the response and the ray-drop network of the LiDAR, and
/// at the poses of one moment. It has no random noise and no weather.
/// @param lidar  index of the log's LiDAR that is the rig
SimulatedSensor camera_sensor(const Camera& camera, const Config& config, const Log& log, int lidar = 0);

/// Returns the gray picture of a scan: intensities of 0 to 1 as in a near-infrared image.
/// Rays without a return are black.
Image draw_camera(const RenderedScan& scan);
/// Returns the depth along the optical axis (z of the camera), in the format of KITTI:
/// metres * 256. Rays without a return, and depths that 16 bits cannot hold, are 0.
DepthImage draw_depth(const RenderedScan& scan);

}  // namespace relidar
