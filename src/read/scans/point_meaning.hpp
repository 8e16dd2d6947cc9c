// SPDX-License-Identifier: Apache-2.0
// Finds the meaning of a LiDAR's point values from some clouds: which field holds the
// intensities, their scale, and the position that marks dropped rays.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "read/files/point_table.hpp"
#include "read/scans/return_pairs.hpp"

namespace relidar::read {

struct IntensityScale {
    double max = 1.0;     ///< intensity that becomes 1
    bool is_sure = true;  ///< false if other scales are equally probable
    std::string about;    ///< text about the scale for a note; empty if the scale is 0 to 1
};
/// Estimates which intensity becomes 1: 1, or 255, or a value that only a few intensities
/// exceed. Reorders the values.
IntensityScale estimate_scale(std::vector<double>& intensities);

struct PointFieldSemantics {
    std::string intensity_field;  ///< name of the field that contains the intensities; may be empty
    IntensityScale scale;
    /// Position that marks a ray without a return, as NaN does.
    std::optional<glm::vec3> no_return;
    UnnumberedReturns returns;
    std::vector<std::string> notes;  ///< texts for the user about each assumption
};
/// Finds the field of intensities, their scale, and how dropped rays are marked.
PointFieldSemantics interpret_fields(const std::vector<PointTable>& sample_clouds);

}  // namespace relidar::read
