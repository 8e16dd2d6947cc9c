// SPDX-License-Identifier: Apache-2.0
// How the intensities that a sensor measures scatter about those that a scene renders:
// their grain along a beam and from beam to beam, and their steps. A decision tree looks
// at what is rendered around a ray and at what was drawn before it; a leaf holds what was
// measured in such places. (Not in the paper.)
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace relidar {

/// What a scene renders for the rays of a scan, row by row; columns go round. All arrays
/// are [rows*columns].
struct RenderedIntensities {
    int rows = 0, columns = 0;
    std::vector<float> intensity;
    std::vector<float> range_m;        ///< of the dominant surface; 0 where nothing is met
    std::vector<float> spread_m;       ///< see range_spread()
    std::vector<float> cosine;         ///< of the angle of incidence; below 0 where it is not known
    std::vector<float> elevation_rad;  ///< of the ray, which tells the beam
};

/// In place of an intensity where nothing came back.
inline constexpr float kNoIntensity = std::numeric_limits<float>::lowest();

/// A rendered scan and what was measured along the same rays.
struct MeasuredIntensities {
    RenderedIntensities rendered;
    std::vector<float> measured;  ///< [rows*columns] kNoIntensity where nothing came back
};

/// How a LiDAR's intensities scatter.
struct IntensityScatter {
    /// Of the tree. Every node has values; an inner one those of its two children.
    struct Node {
        std::int32_t feature = -1;  ///< what it asks for, below count_scatter_features(); -1: it is a leaf
        float at = 0.0f;            ///< up to this the first child is next, above it the second
        std::int32_t child = 0;     ///< position of the first child; the second follows it
        std::uint32_t first = 0, count = 0;  ///< in `values`
    };
    std::vector<Node> nodes;    ///< [0] the root; none: nothing is known
    std::vector<float> values;  ///< intensities that were measured, leaf by leaf
    double step = 0.0;          ///< all intensities of the log are multiples of it; 0: they come in no steps

    bool empty() const { return nodes.empty(); }
    /// The multiple of the step nearest to an intensity.
    float quantised(float intensity) const;
};

/// What a node of the tree may ask for is counted from 0 to this.
std::size_t count_scatter_features();

/// The largest number of which all values are multiples, to a millionth of the largest
/// value. 0 where there is none above a hundredth of a thousandth of that, and where
/// fewer than eight different values tell nothing. @param values  >= 0, in any order
double find_step(std::vector<float> values);

/// Fits the tree to scans of one LiDAR: nodes are parted where that tells most of what
/// was measured, by entropy. The same for the same images, on any number of threads.
/// @return empty for fewer than a thousand returns
/// @throws DataError for arrays of other sizes than their image
IntensityScatter fit_scatter(std::span<const MeasuredIntensities> images);

/// Draws what a sensor may have measured: ray by ray along the beams, the highest first,
/// given what was drawn before.
/// @param returns [rows*columns] 0 where nothing comes back @return [rows*columns]
/// kNoIntensity there
std::vector<float> draw_intensities(const IntensityScatter& scatter, const RenderedIntensities& rendered,
                                    std::span<const std::uint8_t> returns, std::uint64_t seed);

}  // namespace relidar
