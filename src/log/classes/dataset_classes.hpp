// SPDX-License-Identifier: Apache-2.0
// Converts the class labels of datasets to relidar's classes. Labels without a row in the
// tables become `unknown`: noise, the recording vehicle, or unlabelled points.
#pragma once

#include <string_view>

#include <relidar/log/classes.hpp>

namespace relidar {

SurfaceClass convert_semantic_kitti_label(int label);
SurfaceClass convert_nuscenes_class(std::string_view category);
SurfaceClass convert_waymo_class(int class_number);

}  // namespace relidar
