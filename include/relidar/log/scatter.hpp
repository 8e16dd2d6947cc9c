// SPDX-License-Identifier: Apache-2.0
// Statistical model of the difference between measured and rendered intensities, which
// comes from noise along a beam, differences between beams, and quantisation. The inputs
// of a decision tree are the rendered values around a ray and the intensities that were
// already drawn. Each leaf holds measured intensities. (Not in the paper.)
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

namespace relidar {

/// Rendered values for all rays of a scan, row by row. All arrays are [rows*columns].
struct RenderedIntensityImage {
    int rows = 0, columns = 0;
    std::vector<float> intensity;
    /// Median range of the ray in metres (RenderedScan::median_range_m). 0: no hit.
    std::vector<float> range_m;
    std::vector<float> spread_m;       ///< result of range_spread()
    std::vector<float> cosine;         ///< of the angle of incidence; negative if unknown
    std::vector<float> elevation_rad;  ///< Elevation of the ray. It identifies the beam.
    bool circular = true;              ///< True if the image covers a full turn.
};

/// Value in an array of intensities that marks a ray without a return.
inline constexpr float kNoIntensity = std::numeric_limits<float>::lowest();

/// A rendered scan and the measured intensities of the same rays.
struct PairedIntensities {
    RenderedIntensityImage rendered;
    std::vector<float> measured;  ///< [rows*columns] kNoIntensity for rays without a return
};

/// A decision tree whose leaves hold measured intensities.
struct IntensityScatterModel {
    /// The range of entries in `values` holds the measured intensities of a node,
    /// including those of its children.
    struct DecisionTreeNode {
        /// Feature that is compared with `at`, below count_features(). -1: leaf
        std::int32_t feature = -1;
        /// The search continues with the first child if the feature is at most this
        /// value.
        float at = 0.0f;
        std::int32_t child = 0;  ///< Index of the first child. The second child has the next index.
        std::uint32_t first = 0, count = 0;  ///< range of entries in `values`
    };
    std::vector<DecisionTreeNode> nodes;  ///< The first is the root. Empty: no model.
    std::vector<float> values;            ///< measured intensities, leaf by leaf
    /// All intensities of the log are multiples of this step. 0: they are not quantised.
    double step = 0.0;

    bool empty() const { return nodes.empty(); }
    /// Returns the multiple of `step` that is nearest to an intensity.
    float quantise(float intensity) const;
};

/// Returns the number of features of a ray.
std::size_t count_features();

/// Returns the quantisation step of intensities: the largest number of which all values
/// are multiples. M is the largest value, and a value may differ from a multiple by 1e-6
/// M. Returns 0 if no step >= 1e-5 M exists, or if fewer than eight values are distinct.
/// @param values  >= 0, in any order
double find_step(std::vector<float> values);

/// Fits the decision tree to scans of a LiDAR. Splits nodes so that the entropy of the
/// measured intensities decreases. The result does not depend on the number of threads.
/// @return an empty tree if there are fewer than a thousand returns
/// @throws DataError if an array has another size than its image
IntensityScatterModel fit_scatter(std::span<const PairedIntensities> images);

/// Draws random intensities that a sensor could have measured. Processes the rays beam by
/// beam from top to bottom, because an intensity also depends on the intensities of
/// neighbouring rays that were drawn before.
/// @param return_flags [rows*columns] 0 for rays without a return
/// @return [rows*columns] kNoIntensity for rays without a return
std::vector<float> draw_intensities(const IntensityScatterModel& scatter,
                                    const RenderedIntensityImage& rendered,
                                    std::span<const std::uint8_t> return_flags, std::uint64_t seed);

}  // namespace relidar
