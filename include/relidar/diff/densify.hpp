// SPDX-License-Identifier: Apache-2.0
// Densification on the device, for the background and all actors together. Adds surfels
// in places where the image needs more of them, and removes useless surfels
// (docs/method.md section 6). Keeps parameters, optimiser moments and statistics in the
// same order.
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

// Content types of device arrays. Kernels use them to distinguish arrays of the same
// element type.
namespace shared {
struct GradientSums;
struct SeenBatches;
struct SeenFrames;
struct TouchedSurfels;
}  // namespace shared

/// Statistics of each surfel since the last densification. The arrays may be larger than
/// n. Checkpoints contain them.
struct SurfelStatistics {
    /// Norm of the gradient of the mean, summed over batches, [n].
    Array<float, shared::GradientSums> gradient_sum;
    /// Number of batches whose frame shows the surfel, [n].
    Array<std::uint32_t, shared::SeenBatches> n_seen;
    /// Bit f is set if the surfel, or the surfel it was copied from, has had a gradient
    /// in training frame f, [n, n_words].
    Array<std::uint32_t, shared::SeenFrames> frames;
    std::uint32_t n_words = 1;
};

/// Batch whose gradients have been computed.
struct ObservedBatch {
    const SurfelArrays* gradients = nullptr;
    /// 1 for each surfel whose gradient is defined and not zero, [n].
    const Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    std::uint32_t frame = 0;  ///< Index among the training frames.
    /// True if the batch has all rays of the frame; false if it has every s-th ray.
    bool whole_frame = true;
};

class Densifier {
public:
    /// Allocates the statistics for a scene.
    /// @param initial scene at the start of training, with its surfels
    /// @param alpha_min value of the image model
    /// @param n_frames number of training frames
    /// @param seed seed of the random numbers, which depend only on the seed, the step
    /// and the surfel
    Densifier(Device& device, const Scene& initial, const DensifyOptions& options, float alpha_min,
              std::uint32_t n_frames, std::uint64_t seed);
    ~Densifier();

    /// Returns false with DensifyStrategy::none. Then the densifier does nothing and has
    /// no statistics.
    bool is_active() const;
    /// Records an update of the statistics with a batch.
    void observe(Stream& stream, const DeviceScene& scene, const ObservedBatch& batch);
    /// Returns true if surfels are to be added or removed after this step.
    bool due(int step) const;
    /// Adds and removes surfels. Surfels keep their order, each model stays a contiguous
    /// range, and copies are stored next to their original. Surviving surfels keep their
    /// moments. New surfels, and surfels whose opacity or scale was changed, start with
    /// zero moments. Statistics are reset. Blocks for one readback of the surfel counts
    /// of each model, which determine sizes and layout. Data that other objects hold for
    /// the surfels (Gradients, Accel) is then out of date.
    ///
    /// Insufficient memory is not an error: growth ends, and the report contains one note
    /// about it.
    /// @param others_bytes bytes per surfel that other objects will allocate again for
    /// the new size; growth leaves this memory free
    DensifyReport run(Stream& stream, DeviceScene& scene, Adam& adam, int step, double others_bytes = 0.0);
    /// Records the reset of opacities if it is due after this step.
    void after_step(Stream& stream, DeviceScene& scene, Adam& adam, int step);
    SurfelStatistics& statistics();
    std::vector<double>& extents_m();              ///< Extent of each model, metres.
    const std::vector<double>& extents_m() const;  ///< Extent of each model, metres.

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
