// SPDX-License-Identifier: Apache-2.0
// Which rays of a frame one iteration looks at.
#pragma once

#include <memory>
#include <vector>

#include <relidar/loss.hpp>
#include <relidar/traversal.hpp>

#include "core/random.hpp"

namespace relidar {

struct Config;
struct FrameData;

/// Whole columns of a frame, copied into a batch of their own.
struct ColumnWindow {
    std::uint32_t columns = 0;     ///< of the frame; 0 = the batch points into the frame's own rays
    std::uint32_t first = 0;       ///< of the window; columns wrap around
    std::uint32_t n_columns = 0;
};

/// Rays of one iteration and what they measured.
struct SampledBatch {
    RayBatch rays;
    TargetBatch targets;
    ColumnWindow window{};
};

/// Samples train.rays_per_iteration rays of a frame: all of them (0), every n-th one in image order (train.batch = rays), or a window
/// of whole neighbouring columns (columns), which is an image, as structural similarity and Chamfer want it. Frames without image
/// order count as one row.
class BatchSampler {
public:
    /// @throws UsageError where structural similarity is wanted of batches or frames that are no images
    BatchSampler(Device& device, const Config& config, const std::vector<FrameData>& frames);
    ~BatchSampler();
    /// Records what is needed to have the batch on the device; valid until the next call.
    SampledBatch sample(Stream& stream, const FrameData& frame, Random& random);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
