// SPDX-License-Identifier: Apache-2.0
// Finds the two returns of a ray in clouds without return numbers. Sensors in dual-return
// mode repeat the only return of most rays, so many points occur twice.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "read/files/point_table.hpp"

namespace relidar::read {

/// How a cloud stores two returns of each ray without numbers.
struct UnnumberedReturns {
    bool exist = false;
    /// Difference between the indices of both returns. Blocks of `distance` points are
    /// alternately first and second returns. 0: the returns have equal rings and times.
    std::size_t distance = 0;
    bool are_halves = false;  ///< true if the distance is half of the points of each cloud
    std::string about;        ///< note for the user
};

/// Finds out whether clouds have two returns of each ray without return numbers.
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

}  // namespace relidar::read
