// SPDX-License-Identifier: Apache-2.0
// Which rays of a frame one iteration looks at.
#pragma once

#include <memory>
#include <vector>

#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>

#include "base/random.hpp"

namespace relidar {

struct Config;
struct FrameData;

/// Columns of a frame, whole, copied into a batch of their own:
/// shared::GatherColumnsParams says which.
struct ColumnWindow {
    std::uint32_t columns = 0;  ///< of the frame; 0 = the batch points into the frame's own rays
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_columns = 0;
};

/// Rays of one iteration and what they measured.
struct SampledBatch {
    RayBatch rays;
    TargetBatch targets;
    ColumnWindow window{};

    /// Which ray of the frame ray k of the batch is.
    std::size_t ray_of_frame(std::uint32_t k) const;
};

/// Samples about train.rays_per_iteration rays of a frame: all of them (0); every n-th
/// group of RELIDAR_COLUMN_GROUP neighbouring columns, the first column drawn from all of
/// them; or, where structural similarity or normal consistency want it
/// (Config::needs_images), a window of neighbouring columns. Both are images, and rays
/// which run together open the same nodes: by groups of four a step of `quick` takes 0.78
/// of what it takes by single columns. Of a frame without image order every n-th ray is
/// taken.
class BatchSampler {
public:
    /// @throws UsageError where structural similarity or normal consistency is wanted of
    /// batches or frames that are no images
    BatchSampler(Device& device, const Config& config, const std::vector<FrameData>& frames);
    ~BatchSampler();
    /// Records what is needed to have the batch on the device; valid until the next call.
    SampledBatch sample(Stream& stream, const FrameData& frame, Random& random);
    /// The same for several batches of a frame, which share its rays out, but for a few
    /// columns where a ring closes; windows do not.
    /// @param first  where the first of them begins, from draw_first() @param k  which
    /// one
    SampledBatch take(Stream& stream, const FrameData& frame, std::uint32_t first, std::uint32_t k);
    /// Draws the column, or ray, that a batch begins at.
    std::uint32_t draw_first(const FrameData& frame, Random& random) const;
    /// How many batches share the rays of a frame out; 1 of windows.
    std::uint32_t n_batches(const FrameData& frame) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
