// SPDX-License-Identifier: Apache-2.0
// Poses as numpy arrays: [4,4] float64 matrices a_from_b. A track is a pair of times and
// poses.
#pragma once

#include <string>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>
#include "arrays.hpp"

namespace relidar::python {

/// Returns the rigid pose of a [4,4] float64 matrix.
/// @throws DataError if the matrix is not finite or not a rigid motion, or as
/// check_array()
Pose pose_of(const py::handle& matrix, const std::string& what);

/// Returns the track of a constant pose, or of (times [n] float64, poses [n,4,4]
/// float64).
/// @param time_s time of a constant pose
/// @throws DataError as pose_of(), and for any other object
PoseTrack track_of(const py::handle& object, const std::string& what, double time_s);

/// Returns poses from a [n,4,4] array.
/// @throws DataError as pose_of()
std::vector<Pose> poses_of(const py::handle& matrices, const std::string& what);

/// Returns a [4,4] float64 array.
py::array to_matrix_array(const Pose& pose);

/// Returns (times [n], poses [n,4,4]) with an offset added to all positions.
py::tuple to_track(const PoseTrack& track, const glm::dvec3& offset_m);

}  // namespace relidar::python
