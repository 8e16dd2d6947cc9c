// SPDX-License-Identifier: Apache-2.0
// How surfels are added and removed in training (docs/method.md section 6): what there is
// to choose, and what came of it. Who does it is in relidar/diff/densify.hpp.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>

namespace relidar {

/// What is added and removed.
enum class DensifyStrategy {
    none,
    adaptive  ///< the paper's: clone and split by gradient, prune, reset opacities
};

/// When and by which bounds; the defaults are the paper's (section 6). An extent is 4 x
/// the size of an actor's box, and of the background and models without a box 3 x the
/// 90th percentile of 2 |p - centre|, both of the scene training starts from.
struct DensifyOptions {
    DensifyStrategy strategy = DensifyStrategy::none;
    int from = 500;     ///< first step, included
    int until = 15000;  ///< last step, excluded
    int every = 100;
    /// mean norm of dL/d(mean), 1/m, above which a surfel grows; L is a mean over a
    /// frame's rays
    double gradient_threshold = 2e-4;
    /// of the extent: below, a growing surfel is cloned, above, it is split
    double clone_extent_share = 2e-4;
    /// fainter ones are removed; never less than ImageModel::alpha_min, which is traced
    double min_opacity = 0.003;
    double max_extent_share = 0.01;  ///< of the extent: larger ones are removed ...
    int large_from = 3000;           ///< ... after this step
    int opacity_reset_every = 3000;  ///< until `until`; 0 = never
    double reset_opacity = 0.01;     ///< at least 2.5 times ImageModel::alpha_min, which is traced
    int max_surfels = 4000000;       ///< no growth beyond; a scene that starts larger is not cut
    bool operator==(const DensifyOptions&) const = default;
};

/// What one densification did.
struct DensifyReport {
    std::uint32_t before = 0, after = 0;
    std::uint32_t added = 0;  ///< rows more than survivors: a clone and a split add one each
    /// wanted by their gradient; where the sum exceeds `added` there was no room for all
    std::uint32_t clones = 0, splits = 0;
    /// removed: not finite, opacity, scale, box
    std::uint32_t invalid = 0, faint = 0, large = 0, outside = 0;
    std::string note;  ///< once, when memory ends the growth; empty otherwise

    std::uint32_t removed() const { return invalid + faint + large + outside; }
    /// Counts of another one are added; its sizes, and its note where it has one, take
    /// the place of these.
    void add(const DensifyReport& later);
};

/// All its counts by name.
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
