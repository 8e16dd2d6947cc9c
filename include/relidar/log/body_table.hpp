// SPDX-License-Identifier: Apache-2.0
// The body that carries a LiDAR, as the LiDAR sees it.
#pragma once

#include <cstddef>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Directions in which a LiDAR sees the body that carries it, for example a roof rack, a
/// robot or a person, in cells of half a degree. find_own_body() measures the table.
struct BodyTable {
    static constexpr int kRows = 360, kColumns = 720;
    static constexpr std::size_t kCells = std::size_t(kRows) * std::size_t(kColumns);
    static constexpr float kNoReturn = -1.0f;
    /// [kCells] distance of the body; 0: nothing of it is in this cell. Empty: no body.
    std::vector<float> range_m;
    /// [kCells] intensity of the body; kNoReturn: it blocks the rays and does not return
    std::vector<float> intensity;

    bool empty() const { return range_m.empty(); }
    /// Returns the index of the cell of a direction. Row 0 is at the zenith, column 0 at
    /// azimuth 180 degrees, and the azimuth decreases.
    static std::size_t cell_of(const glm::vec3& direction);
    /// Returns the unit vector to the centre of a cell.
    static glm::vec3 direction_of(std::size_t cell);
    /// Returns true if a return is on the body or nearer, or if a dropped ray (range 0)
    /// may have hit the body. Includes the cells around the body, because its edge moves.
    bool hides(const glm::vec3& direction, float measured_range_m) const;
};

}  // namespace relidar
