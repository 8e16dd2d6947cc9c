// SPDX-License-Identifier: Apache-2.0
// Scans as messages of Foxglove's schemas in protobuf, with the descriptors that a reader decodes them by.
#pragma once

#include <string>

#include "recorded_scan.hpp"

namespace relidar::scan_files {

/// A FileDescriptorSet of foxglove.PointCloud, foxglove.FrameTransform and foxglove.SceneUpdate, and of what they are made of.
std::string foxglove_descriptors();

std::string foxglove_points(const RecordedScan& scan);
/// Of the sensor in the world.
std::string foxglove_transform(const RecordedScan& scan);
/// Boxes of the actors, which replace all there were.
std::string foxglove_boxes(const RecordedScan& scan);

}  // namespace relidar::scan_files
