// SPDX-License-Identifier: Apache-2.0
// Converts the class labels of datasets to relidar's classes. Labels without a row in the
// tables become `unknown`: noise, the recording vehicle, or unlabelled points.
#pragma once

#include <string_view>

#include <relidar/log/classes.hpp>

namespace relidar {

SurfaceClass from_semantic_kitti(int label);
/// Returns a label of the class for objects that stand still, or 0 if there is none.
int to_semantic_kitti(SurfaceClass surface);
SurfaceClass from_nuscenes(std::string_view category);
SurfaceClass from_waymo(int class_number);

}  // namespace relidar
