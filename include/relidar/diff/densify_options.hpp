// SPDX-License-Identifier: Apache-2.0
// Options and reports of densification, which adds and removes surfels during training
// (docs/method.md section 6).
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>

namespace relidar {

enum class DensifyStrategy {
    none,
    /// Strategy of the paper: clones and splits surfels with large gradients, removes
    /// useless surfels, and resets opacities.
    adaptive
};

/// Schedule and thresholds of densification. The defaults are the paper's values (section
/// 6). Some thresholds are relative to the extent of a model. The extent of an actor is 4
/// x the size of its box. For the background and for models without a box, the extent is
/// 3 x the 90th percentile of 2 |p - centre|. Extents are computed from the scene at the
/// start of training.
struct DensifyOptions {
    DensifyStrategy strategy = DensifyStrategy::none;
    int from = 500;     ///< First step with densification.
    int until = 15000;  ///< Densification ends before this step.
    int every = 100;
    /// Threshold for the mean norm of dL/d(mean position), 1/m. A surfel with a larger
    /// norm is cloned or split. The loss L is a mean over the rays of a frame.
    double gradient_threshold = 2e-4;
    /// Size limit, relative to the extent of the model. A surfel with a large gradient is
    /// cloned if it is smaller than the limit, and split if it is larger.
    double clone_extent_share = 2e-4;
    /// Minimum opacity. Surfels with a lower opacity are removed. Rays ignore surfels
    /// below the opacity ImageModel::alpha_min, so the larger of the two limits is used.
    double min_opacity = 0.003;
    /// Maximum scale of a surfel, relative to the extent of the model. After step
    /// `large_from`, larger surfels are removed.
    double max_extent_share = 0.01;
    int large_from = 3000;  ///< Step after which surfels that are too large are removed.
    /// Number of steps between opacity resets, up to step `until`. 0 = never.
    int opacity_reset_every = 3000;
    /// Opacity after a reset. Values below 2.5 times ImageModel::alpha_min are
    /// raised to that limit.
    double reset_opacity = 0.01;
    /// Maximum number of surfels that densification may reach. Densification does not
    /// reduce a scene that has more surfels at the start.
    int max_surfels = 4000000;
    bool operator==(const DensifyOptions&) const = default;
};

struct DensifyReport {
    std::uint32_t before = 0, after = 0;
    std::uint32_t added = 0;  ///< Number of added surfels. Each clone or split adds one surfel.
    /// Numbers of surfels whose gradients are large enough for cloning or splitting. The
    /// number of added surfels can be lower, if max_surfels is reached or memory is
    /// short.
    std::uint32_t clones = 0, splits = 0;
    /// Number of removed surfels by reason: value not finite, low opacity, large scale,
    /// outside the actor's box.
    std::uint32_t invalid = 0, faint = 0, large = 0, outside = 0;
    /// Message that there is too little memory for more surfels. Only the first report
    /// about this problem contains the message. Empty otherwise.
    std::string note;

    std::uint32_t n_removed() const { return invalid + faint + large + outside; }
    /// Adds the counts of a later report to this report. `after` and a non-empty `note`
    /// are copied from the later report.
    void add_counts(const DensifyReport& later_report);
};

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
