// SPDX-License-Identifier: Apache-2.0
// Densification on the device, of the background and all actors at once: surfels are
// added where the scans need more of them and removed where they do nothing
// (docs/method.md section 6). Parameters, optimiser moments and statistics move together.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <relidar/diff/densify_options.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

class Adam;
class DeviceScene;
struct Scene;
struct SurfelArrays;

namespace shared {  // what arrays hold, as kernels tell them apart
struct GradientSums;
struct SeenBatches;
struct SeenFrames;
struct TouchedSurfels;
}  // namespace shared

/// Statistics since the last densification, kept with the surfels; the arrays may have
/// room for more than n. A checkpoint holds them.
struct SurfelStatistics {
    Array<float, shared::GradientSums> gradient_sum;   ///< [n] sum over batches of the norm of the gradient
    Array<std::uint32_t, shared::SeenBatches> n_seen;  ///< [n] batches whose frame shows the surfel
    /// [n, n_words] bit f: the surfel, or what it was copied from, has had a gradient in
    /// training frame f
    Array<std::uint32_t, shared::SeenFrames> frames;
    std::uint32_t n_words = 1;
};

/// A batch whose gradients are there.
struct ObservedBatch {
    const SurfelArrays* gradients = nullptr;
    /// [n] where the gradients are defined and not zero
    const Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    std::uint32_t frame = 0;  ///< place among the training frames
    bool whole_frame = true;  ///< false: every s-th of its rays
};

class Densifier {
public:
    /// @param initial  what training starts from, with its surfels @param alpha_min of
    /// the image model
    /// @param n_frames training frames @param seed of the random numbers, which depend on
    /// it, the step and the surfel alone
    Densifier(Device& device, const Scene& initial, const DensifyOptions& options, float alpha_min,
              std::uint32_t n_frames, std::uint64_t seed);
    ~Densifier();

    /// False with DensifyStrategy::none: nothing is recorded, due or kept then, and there
    /// are no statistics.
    bool is_active() const;
    /// Records one batch into the statistics.
    void observe(Stream& stream, const DeviceScene& scene, const ObservedBatch& batch);
    /// Whether surfels are added or removed after this step.
    bool due(int step) const;
    /// Adds and removes. Surfels keep their order and a model stays one range; copies
    /// stand next to their original. Survivors keep their moments; new surfels, and old
    /// ones whose opacity or scale is changed, start with zeros. Statistics start over.
    /// Blocks, with one readback: the counts of each model, which fix sizes and layout.
    /// What others hold for the surfels of the scene (Gradients, Accel) is out of date
    /// afterwards.
    /// @param others_bytes a surfel, that others will allocate again for the new size:
    /// growth leaves room for it Out of memory is no error: growth ends where it is, and
    /// the report says so once.
    DensifyReport run(Stream& stream, DeviceScene& scene, Adam& adam, int step, double others_bytes = 0.0);
    /// Records the reset of opacities if it is due after this step.
    void after_step(Stream& stream, DeviceScene& scene, Adam& adam, int step);
    SurfelStatistics& statistics();
    std::vector<double>& extents_m();              ///< of each model, metres
    const std::vector<double>& extents_m() const;  ///< the same

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
