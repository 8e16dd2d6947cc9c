// SPDX-License-Identifier: Apache-2.0
// Options and reports of densification, which adds and removes surfels during training
// (docs/method.md section 6). The implementation is in relidar/diff/densify.hpp.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>

namespace relidar {

/// Strategy for adding and removing surfels.
enum class DensifyStrategy {
    none,
    adaptive  ///< Strategy of the paper: clones and splits by gradient, prunes, resets opacities.
};

/// Schedule and thresholds of densification. The defaults are the paper's (section 6).
/// The extent of an actor is 4 x the size of its box. The extent of the background and of
/// models without a box is 3 x the 90th percentile of 2 |p - centre|. Both refer to the
/// scene at the start of training.
struct DensifyOptions {
    DensifyStrategy strategy = DensifyStrategy::none;
    int from = 500;     ///< First step (inclusive).
    int until = 15000;  ///< Last step (exclusive).
    int every = 100;
    /// Threshold of the mean norm of dL/d(mean), 1/m. Surfels with a larger value grow. L
    /// is a mean over the rays of a frame.
    double gradient_threshold = 2e-4;
    /// Threshold between cloning and splitting, relative to the extent. A growing surfel
    /// is cloned if it is smaller, and split if it is larger.
    double clone_extent_share = 2e-4;
    /// Minimum opacity; fainter surfels are removed. ImageModel::alpha_min, which tracing
    /// uses, is a lower bound of this value.
    double min_opacity = 0.003;
    /// Maximum scale, relative to the extent; larger surfels are removed after
    /// `large_from`.
    double max_extent_share = 0.01;
    int large_from = 3000;  ///< Step after which surfels that are too large are removed.
    /// Number of steps between opacity resets, up to step `until`; 0 = never.
    int opacity_reset_every = 3000;
    double reset_opacity = 0.01;  ///< Opacity after a reset; at least 2.5 times ImageModel::alpha_min.
    /// Maximum number of surfels for growth. A larger initial scene is not reduced.
    int max_surfels = 4000000;
    bool operator==(const DensifyOptions&) const = default;
};

/// Result of a densification.
struct DensifyReport {
    std::uint32_t before = 0, after = 0;
    std::uint32_t added = 0;  ///< Number of added surfels; each clone or split adds one.
    /// Number of surfels whose gradient requires a clone or a split. If their sum exceeds
    /// `added`, there was not enough memory for all of them.
    std::uint32_t clones = 0, splits = 0;
    /// Number of removed surfels by reason: not finite, low opacity, large scale, outside
    /// the actor's box.
    std::uint32_t invalid = 0, faint = 0, large = 0, outside = 0;
    /// Note that growth ended because of insufficient memory. Set only once, otherwise
    /// empty.
    std::string note;

    std::uint32_t removed() const { return invalid + faint + large + outside; }
    /// Adds the counts of a later report and adopts its sizes. Adopts its note if it is
    /// not empty.
    void add(const DensifyReport& later);
};

/// Names of all counts of a report.
inline constexpr std::array<std::pair<const char*, std::uint32_t DensifyReport::*>, 9> kDensifyCounts{
    {{"before", &DensifyReport::before},
     {"after", &DensifyReport::after},
     {"added", &DensifyReport::added},
     {"clones", &DensifyReport::clones},
     {"splits", &DensifyReport::splits},
     {"invalid", &DensifyReport::invalid},
     {"faint", &DensifyReport::faint},
     {"large", &DensifyReport::large},
     {"outside", &DensifyReport::outside}}};

}  // namespace relidar
