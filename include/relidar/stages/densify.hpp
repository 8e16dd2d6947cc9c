// SPDX-License-Identifier: Apache-2.0
// Densification on the device, of the background and all actors at once: surfels are added where the scans need more of them and
// removed where they do nothing (docs/method.md section 6). Parameters, optimiser moments and statistics move together.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <relidar/stages/gpu.hpp>

namespace relidar {

class Adam;
class DeviceScene;
struct Scene;
struct SurfelArrays;

/// What is added and removed.
enum class DensifyStrategy {
    none,
    adaptive,     ///< the paper's: clone and split by gradient, prune, reset opacities
    mcmc          ///< "3D Gaussian Splatting as Markov Chain Monte Carlo": the dead move to the living, growth by a share, noise on means
};

/// When and by which bounds; the defaults are the paper's (section 6). An extent is 4 x the size of an actor's box, and of the
/// background and models without a box 3 x the 90th percentile of 2 |p - centre|, both of the scene training starts from.
struct DensifyOptions {
    DensifyStrategy strategy = DensifyStrategy::none;
    int from = 500;                       ///< first step, included
    int until = 15000;                    ///< last step, excluded
    int every = 100;
    double gradient_threshold = 2e-4;     ///< mean norm of dL/d(mean), 1/m, above which a surfel grows; L is a mean over a frame's rays
    double clone_extent_share = 2e-4;     ///< of the extent: below, a growing surfel is cloned, above, it is split
    double min_opacity = 0.003;           ///< fainter ones are removed; never less than ImageModel::alpha_min, which is traced
    double max_extent_share = 0.01;       ///< of the extent: larger ones are removed ...
    int large_from = 3000;                ///< ... after this step
    int opacity_reset_every = 3000;       ///< adaptive, until `until`; 0 = never
    double reset_opacity = 0.01;
    int max_surfels = 4000000;            ///< no growth beyond; a scene that starts larger is not cut
    double growth = 0.05;                 ///< mcmc: share of surfels added each time
    double noise = 0.2;                   ///< mcmc: standard deviation of the noise a step on the means of faint surfels, in scales
    bool operator==(const DensifyOptions&) const = default;
};

/// What one densification did.
struct DensifyReport {
    std::uint32_t before = 0, after = 0;
    std::uint32_t added = 0;                         ///< rows more than survivors: a clone, a split and a relocation add one each
    std::uint32_t clones = 0, splits = 0;            ///< wanted by their gradient; where the sum exceeds `added` there was no room for all
    std::uint32_t invalid = 0, faint = 0, large = 0, outside = 0;   ///< removed: not finite, opacity, scale, box
    std::string note;                                ///< once, when memory ends the growth; empty otherwise

    std::uint32_t removed() const { return invalid + faint + large + outside; }
    /// Counts of another one are added; its sizes, and its note where it has one, take the place of these.
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

/// Statistics since the last densification, kept with the surfels; the arrays may have room for more than n. A checkpoint holds them.
struct SurfelStatistics {
    Array<float> gradient_sum;        ///< [n] sum over batches of the norm of the gradient
    Array<std::uint32_t> n_seen;      ///< [n] batches whose frame shows the surfel
    Array<std::uint32_t> frames;  ///< [n, n_words] bit f: the surfel, or what it was copied from, has had a gradient in training frame f
    std::uint32_t n_words = 1;
};

/// A batch whose gradients are there.
struct ObservedBatch {
    const SurfelArrays* gradients = nullptr;
    const Array<std::uint32_t>* touched = nullptr;   ///< [n] where the gradients are defined and not zero
    std::uint32_t frame = 0;                         ///< place among the training frames
    bool whole_frame = true;                         ///< false: every s-th of its rays
};

class Densifier {
public:
    /// @param initial  what training starts from, with its surfels @param alpha_min of the image model
    /// @param n_frames training frames @param seed of the random numbers, which depend on it, the step and the surfel alone
    Densifier(Device& device, const Scene& initial, const DensifyOptions& options, float alpha_min, std::uint32_t n_frames,
              std::uint64_t seed);
    ~Densifier();

    /// Records one batch into the statistics.
    void observe(Stream& stream, const DeviceScene& scene, const ObservedBatch& batch);
    /// Whether surfels are added or removed after this step.
    bool due(int step) const;
    /// Adds and removes. Surfels keep their order and a model stays one range; copies stand next to their original. Survivors keep
    /// their moments; new surfels, and old ones whose opacity or scale is changed, start with zeros. Statistics start over.
    /// Blocks, with one readback: the counts of each model, which fix sizes and layout. What others hold for the surfels of the scene
    /// (Gradients, Accel) is out of date afterwards.
    /// @param others_bytes a surfel, that others will allocate again for the new size: growth leaves room for it
    /// Out of memory is no error: growth ends where it is, and the report says so once.
    DensifyReport run(Stream& stream, DeviceScene& scene, Adam& adam, int step, double others_bytes = 0.0);
    /// Records what happens every step or at its own times: opacity reset (adaptive), noise (mcmc).
    /// @param rate_share learning rate of the means now over that at the start
    void after_step(Stream& stream, DeviceScene& scene, Adam& adam, int step, double rate_share);
    SurfelStatistics& statistics();
    std::vector<double>& extents_m();               ///< of each model, metres
    const std::vector<double>& extents_m() const;   ///< the same

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
