// SPDX-License-Identifier: Apache-2.0
// What the values of points in a file mean.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::read {

/// How clouds store two returns of each ray without numbers.
struct UnnumberedReturns {
    bool exist = false;
    /// Blocks of this many points are alternately first and second returns: 1 if both
    /// returns of a ray are neighbours. 0: the returns have equal rings and times.
    std::size_t block_size = 0;
    bool are_halves = false;  ///< true: all second returns follow, so a block is half of each cloud
};

/// Units and meaning of the point values in scan files.
struct PointFileUnits {
    /// Names of the columns in .bin and .npy files. Empty means x y z intensity.
    std::vector<std::string> columns;
    /// Intensities are divided by this value. If not set, values above 1 are an error.
    std::optional<double> intensity_max;
    double time_unit_s = 1.0;
    bool absolute_times = false;   ///< true: point times use the clock of the log; false: 0 is the frame
    bool starts_at_frame = false;  ///< true: the first point of a scan has the time of its frame
    /// True if sequence.json does not have this value. If times cannot have the default,
    /// fill_units() estimates the value.
    bool is_unit_open = false, is_reference_open = false;
    /// Field with the intensities. If empty, the first field with a usual name.
    std::string intensity_field = {};
    /// Position that marks a ray without a return, as NaN does.
    std::optional<glm::vec3> no_return = {};
    UnnumberedReturns returns = {};
    bool ignore_times = false;      ///< true if the times of the points are not usable
    bool skip_wrong_times = false;  ///< true: skips points with wrong times; false: throws
    double time_zero = 0.0;         ///< value of the point time at the time 0 s, in the unit of the file
};

}  // namespace relidar::read
