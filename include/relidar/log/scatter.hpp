// SPDX-License-Identifier: Apache-2.0
// Statistical model of the difference between measured and rendered intensities: noise
// along a beam, differences between beams, and quantisation. A decision tree selects a
// leaf from the rendered values around a ray and from the values that were already drawn.
// Each leaf holds the intensities that were measured in such situations. (Not in the
// paper.)
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace relidar {

/// Rendered values for the rays of a scan, row by row. Columns wrap around. All arrays
/// are [rows*columns].
struct RenderedIntensities {
    int rows = 0, columns = 0;
    std::vector<float> intensity;
    std::vector<float> range_m;        ///< range of the dominant surface; 0 if the ray hit nothing
    std::vector<float> spread_m;       ///< result of range_spread()
    std::vector<float> cosine;         ///< cosine of the angle of incidence; negative if unknown
    std::vector<float> elevation_rad;  ///< elevation of the ray, which identifies the beam
};

/// Marks a ray without a return in an array of intensities.
inline constexpr float kNoIntensity = std::numeric_limits<float>::lowest();

/// A rendered scan and the measured intensities of the same rays.
struct MeasuredIntensities {
    RenderedIntensities rendered;
    std::vector<float> measured;  ///< [rows*columns] kNoIntensity for rays without a return
};

/// Decision tree with the measured intensities of a LiDAR.
struct IntensityScatter {
    /// Node of the decision tree. Every node has values; an inner node has the values of
    /// its two children.
    struct Node {
        /// feature to compare, less than count_scatter_features(); -1 for a leaf
        std::int32_t feature = -1;
        /// threshold: the first child is next for values up to it, the second child for
        /// values above it
        float at = 0.0f;
        std::int32_t child = 0;              ///< index of the first child; the second child follows it
        std::uint32_t first = 0, count = 0;  ///< range of entries in `values`
    };
    std::vector<Node> nodes;    ///< nodes, [0] is the root; empty if there is no model
    std::vector<float> values;  ///< measured intensities, leaf by leaf
    /// quantisation step: all intensities of the log are multiples of it; 0 if there is
    /// none
    double step = 0.0;

    bool empty() const { return nodes.empty(); }
    /// Returns the multiple of `step` that is nearest to an intensity.
    float quantised(float intensity) const;
};

/// Returns the number of features that a node of the tree can compare.
std::size_t count_scatter_features();

/// Returns the largest number of which all values are multiples. Rounding errors of up to
/// 1e-6 of the largest value are allowed. Returns 0 if that number is below 1e-5 of the
/// largest value, or if there are fewer than eight distinct values.
/// @param values  >= 0, in any order
double find_step(std::vector<float> values);

/// Fits the decision tree to scans of a LiDAR. Nodes are split to reduce the entropy of
/// the measured values. The result does not depend on the number of threads.
/// @return an empty tree if there are fewer than a thousand returns
/// @throws DataError if an array has another size than its image
IntensityScatter fit_scatter(std::span<const MeasuredIntensities> images);

/// Draws random intensities that a sensor could have measured. Rays are drawn beam by
/// beam, the highest beam first. Each draw depends on the values drawn before it.
/// @param returns [rows*columns] 0 for rays without a return
/// @return [rows*columns] kNoIntensity for rays without a return
std::vector<float> draw_intensities(const IntensityScatter& scatter, const RenderedIntensities& rendered,
                                    std::span<const std::uint8_t> returns, std::uint64_t seed);

}  // namespace relidar
