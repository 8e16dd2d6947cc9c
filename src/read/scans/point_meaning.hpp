// SPDX-License-Identifier: Apache-2.0
// Finds the meaning of a LiDAR's point values from some clouds: which field holds the
// intensities, their scale, and the position that marks dropped rays. Also finds the two
// returns of a ray without return numbers.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "read/files/point_table.hpp"
#include "read/files/point_units.hpp"

namespace relidar::read {

/// Returns the positions of all points. A missing coordinate is 0.
std::vector<glm::vec3> read_positions(const PointTable& table);

/// Returns the values of a field in all clouds that have it.
std::vector<double> list_values(const std::vector<PointTable>& clouds, const std::string& field_name);

struct IntensityScale {
    double max = 1.0;     ///< intensity that becomes 1
    bool is_sure = true;  ///< false if other scales are equally probable
    std::string reason;   ///< why this scale is used
};
/// Estimates which intensity becomes 1: 1, 255, or a value that only few exceed.
IntensityScale estimate_scale(std::vector<double> intensities);

/// Two points can be returns of one ray if the angle between their directions is smaller.
/// It is not 0, because files round coordinates: a centimetre at 7 m has this angle.
inline constexpr double kOneRay_rad = 1.4e-3;

/// Finds out whether clouds have two returns of each ray without return numbers. They
/// store most single returns twice. Without copies, pairs of points with equal ring, time
/// and direction are second returns. In some clouds, all rays can have one return.
UnnumberedReturns find_unnumbered(const std::vector<PointTable>& clouds);

/// Returns the number of each selected point: 1 for the stronger return of a ray, 2 for
/// the other. Sorts the points so that a second return follows its first return. Removes
/// a return that is equal to the other return of its ray.
/// @param selected  indices of points in the table
/// @param points  [selected] positions
std::vector<std::uint8_t> number_returns(const PointTable& table, const UnnumberedReturns& layout,
                                         const std::string& intensity_field,
                                         std::vector<std::uint32_t>& selected,
                                         std::vector<glm::vec3>& points);

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
