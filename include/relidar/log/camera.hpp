// SPDX-License-Identifier: Apache-2.0
// Cameras that a user can name.
#pragma once

#include <array>
#include <string>

#include <relidar/log/log.hpp>

namespace relidar {

/// Returns the camera with a projection matrix of KITTI. The caller sets its size.
/// @param projection  [3,4] row-major. A point p in the frame of the rectified camera 0
/// has the pixel projection * (p, 1).
Camera make_camera(const std::string& name, const std::array<double, 12>& projection,
                   const Pose& rectified_from_rig);
/// Returns camera 2 of KITTI (left colour camera, rectified) of 2011-09-26: 1242 x 375.
Camera kitti_camera();
/// Returns CAM_FRONT of nuScenes, 1600 x 900, mounted relative to LIDAR_TOP.
Camera nuscenes_camera();

/// Returns the azimuths that a camera sees, in the frame of its rig.
AzimuthInterval view_azimuths(const Camera& camera);

/// Returns the camera that a text in JSON describes:
///   {"name": "front", "K": [fx, 0, cx, 0, fy, cy, 0, 0, 1], "size": [columns, rows],
///    "translation_m": [0.27, 0, -0.08], "yaw_pitch_roll_deg": [0, 0, 0]}
/// The mounting has the keys of a rig's sensor; a camera with angles 0 looks forward.
/// "quaternion" [w, x, y, z] replaces the angles: rotation from the frame of the camera
/// to that of the rig. Missing keys of the mounting are 0, a missing name is "camera".
/// @param where  name of the text in error messages
/// @throws DataError naming the key that is wrong
Camera parse_camera(const std::string& text, const std::string& where);
/// Returns a camera of the log by its name, "kitti", "nuscenes", or the camera in a JSON
/// file.
/// @param lidar  LiDAR of the log whose frame is that of the rig
/// @throws UsageError if the name is unknown and no file
/// @throws errors of parse_camera()
Camera choose_camera(const std::string& name_or_file, const Log& log, int lidar = 0);

}  // namespace relidar
