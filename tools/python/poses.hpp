// SPDX-License-Identifier: Apache-2.0
// Converts poses between C++ and numpy arrays. A pose is a [4,4] float64 matrix. A track
// is a pair (times, poses).
#pragma once

#include <string>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>
#include "arrays.hpp"

namespace relidar::python {

/// Converts a [4,4] float64 matrix to a pose.
/// @throws DataError if the matrix has a wrong type or shape, is not finite, or is not a
/// rigid motion
Pose convert_matrix_to_pose(const py::handle& matrix, const std::string& name_for_errors);

/// Converts a single pose or a pair (times [n], poses [n,4,4]) of float64 arrays to a
/// track.
/// @param time_of_single_pose_s time of a single pose
/// @throws DataError if the object has another form, or if a pose is not a rigid motion
PoseTrack convert_python_poses_to_track(const py::handle& pose_or_times_and_poses,
                                        const std::string& name_for_errors, double time_of_single_pose_s);

/// Converts an array [n,4,4] to n poses.
/// @throws DataError if a matrix is not a rigid motion
std::vector<Pose> convert_to_poses(const py::handle& matrices, const std::string& name_for_errors);

/// Converts a pose to a [4,4] float64 array.
py::array convert_pose_to_matrix_array(const Pose& pose);

/// Returns a track as (times [n], poses [n,4,4]). Adds the offset to all positions.
py::tuple convert_track_to_times_and_poses(const PoseTrack& track, const glm::dvec3& position_offset_m);

}  // namespace relidar::python
