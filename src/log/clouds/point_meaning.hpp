// SPDX-License-Identifier: Apache-2.0
// Finds out from some clouds of a LiDAR what the values of its points mean: which field
// holds the intensities, what their scale is, and which position marks dropped rays.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "log/clouds/point_table.hpp"

namespace relidar::folder {

/// Scale of intensities.
struct IntensityScale {
    double max = 1.0;     ///< intensity that becomes 1
    bool is_sure = true;  ///< false: other scales explain the values equally well
    std::string about;    ///< description for a note; empty if the scale is 0 to 1
};
/// Estimates the scale from some intensities. The scale is 1, or 255, or a value that
/// only a few intensities exceed. The order of the values changes.
IntensityScale find_scale(std::vector<double>& intensities);

/// What the values of a LiDAR's points mean.
struct PointMeaning {
    std::string intensity_field;  ///< name of the field with the intensities; may be empty
    IntensityScale scale;
    /// Position that marks a ray without a return, in addition to those that is_return()
    /// rejects.
    std::optional<glm::vec3> no_return;
    std::vector<std::string> notes;  ///< descriptions of everything that was assumed
};
/// @param clouds  some clouds of the LiDAR
PointMeaning find_meaning(const std::vector<PointTable>& clouds);

}  // namespace relidar::folder
