// SPDX-License-Identifier: Apache-2.0
// Converts the class labels of datasets to relidar's classes. Labels without a row in the
// tables become `unknown`: noise, the recording vehicle, or unlabelled points.
#pragma once

#include <string_view>

#include <relidar/log/classes.hpp>

namespace relidar {

/// @param label  number of a class in SemanticKITTI
SurfaceClass convert_semantic_kitti_label(int label);
/// @param category  name of a category in nuScenes, for example "flat.sidewalk"
SurfaceClass convert_nuscenes_class(std::string_view category);
/// @param class_number  number of a Segmentation.Type in Waymo Open
SurfaceClass convert_waymo_class(int class_number);

}  // namespace relidar
