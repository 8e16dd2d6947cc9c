// SPDX-License-Identifier: Apache-2.0
// Poses as numpy arrays: [4,4] float64 matrices a_from_b, and tracks as pairs of times
// and poses.
#pragma once

#include <string>

#include <relidar/base/math.hpp>
#include <relidar/log/sequence.hpp>
#include "arrays.hpp"

namespace relidar::python {

/// A rigid pose from [4,4] float64. @throws DataError where the matrix is not finite or
/// no rigid motion, or as check_array()
Pose pose_of(const py::handle& matrix, const std::string& what);

/// A single pose, which stands; or (times [n] float64, poses [n,4,4] float64). @param
/// time_s  of a single pose
/// @throws DataError as pose_of(), and for anything else
PoseTrack track_of(const py::handle& object, const std::string& what, double time_s);

/// [n,4,4] poses. @throws DataError as pose_of()
std::vector<Pose> poses_of(const py::handle& matrices, const std::string& what);

/// [4,4] float64
py::array to_matrix_array(const Pose& pose);

/// (times [n], poses [n,4,4]) with an offset added to all positions.
py::tuple to_track(const PoseTrack& track, const glm::dvec3& offset_m);

}  // namespace relidar::python
