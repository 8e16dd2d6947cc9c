// SPDX-License-Identifier: Apache-2.0
// Converts poses between C++ and numpy arrays. A pose is a [4,4] float64 matrix. A track
// is a pair (times, poses).
#pragma once

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>
#include "arrays.hpp"

namespace relidar::python {

Pose to_pose(const py::handle& matrix, const std::string& where);

/// @param time_s time of a single pose
/// @throws DataError if the object has another form, or a pose is not a rigid motion
PoseTrack to_track(const py::handle& object, const std::string& where, double time_s);

std::vector<Pose> to_poses(const py::handle& matrices, const std::string& where);

py::array pose_matrix(const Pose& pose);

py::tuple to_times_and_poses(const PoseTrack& track, const glm::dvec3& position_offset_m);

}  // namespace relidar::python
