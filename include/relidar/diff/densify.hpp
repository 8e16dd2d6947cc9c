// SPDX-License-Identifier: Apache-2.0
// Densification on the device, for the background and all actors together. It adds
// surfels where the rendered image lacks detail and removes useless surfels
// (docs/method.md section 6). Parameters, Adam moments and statistics always keep the
// same surfel order.
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

namespace shared {
struct GradientSums;
struct SeenBatches;
struct SeenFrames;
struct TouchedSurfels;
}  // namespace shared

/// Statistics of each surfel since the last densification, which adds and removes
/// surfels. Checkpoints store these statistics. The arrays may have more than n entries.
struct SurfelStatistics {
    /// Norm of the gradient with respect to the surfel's mean position, summed over
    /// batches, [n].
    Array<float, shared::GradientSums> gradient_sum;
    /// Number of batches whose frame shows the surfel, [n].
    Array<std::uint32_t, shared::SeenBatches> n_observing_batches;
    /// Bit mask of training frames, [n, n_words]. Bit f is set if the surfel has had a
    /// gradient in frame f. A copy of a surfel inherits the bits.
    Array<std::uint32_t, shared::SeenFrames> frames;
    std::uint32_t n_words = 1;
};

struct BackpropagatedBatch {
    const SurfelArrays* gradients = nullptr;
    /// Flags, [n]: 1 for each surfel that gets a gradient from the batch. The gradients
    /// of other surfels may be undefined.
    const Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    std::uint32_t frame = 0;  ///< Index of the batch's frame in the list of training frames.
    /// True if the batch has all rays of the frame. False if it has only every s-th ray.
    bool is_full_frame = true;
};

class Densifier {
public:
    /// Allocates the statistics for a scene.
    /// @param initial scene at the start of training, with its surfels
    /// @param alpha_min alpha_min of the image model
    /// @param n_frames number of training frames
    /// @param seed seed of the random numbers. The numbers depend only on the seed, the
    /// step and the surfel.
    Densifier(Device& device, const Scene& initial, const DensifyOptions& options, float alpha_min,
              std::uint32_t n_frames, std::uint64_t seed);
    ~Densifier();

    /// Returns false if the strategy is DensifyStrategy::none. The densifier then does
    /// nothing and has no statistics.
    bool is_enabled() const;
    /// Records GPU commands that add the gradients of a batch to the statistics of the
    /// surfels.
    void record_statistics(Stream& stream, const DeviceScene& scene, const BackpropagatedBatch& batch);
    /// Returns true if densify_surfels() should add and remove surfels after this step.
    bool is_densify_step(int step) const;
    /// Adds and removes surfels. Surfels keep their order, and a copy is stored next to
    /// its original. Surviving surfels keep their Adam moments; new and changed surfels
    /// start with zero. All statistics are reset. Waits for the GPU once. Afterwards, the
    /// caller must create the gradient arrays and the acceleration structure again.
    /// If memory is short, no more surfels are added, and one report has a note about it.
    /// @param reserved_bytes_per_surfel memory that densification leaves free for other
    /// objects
    DensifyReport densify_surfels(Stream& stream, DeviceScene& scene, Adam& adam, int step,
                                  double reserved_bytes_per_surfel = 0.0);
    /// Records GPU commands that reset the opacities of all surfels, if a reset is
    /// scheduled after this step.
    void reset_opacities(Stream& stream, DeviceScene& scene, Adam& adam, int step);
    SurfelStatistics& statistics();
    std::vector<double>& model_extents_m();              ///< Extent of each model, metres.
    const std::vector<double>& model_extents_m() const;  ///< Extent of each model, metres.

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
