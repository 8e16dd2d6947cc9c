// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <relidar/diff/loss.hpp>
#include <relidar/diff/traversal.hpp>

#include "base/random.hpp"
#include "gpu/kernel.hpp"
#include "train/shared/train.h"

namespace relidar {

struct Config;
struct TrainingFrameData;
struct BatchPlan;

/// Columns of a frame that are copied into a batch (shared::GatherColumnsParams).
struct ColumnWindow {
    /// number of columns of the full frame; 0 if no columns are copied, because the batch
    /// uses the arrays of the frame directly
    std::uint32_t columns = 0;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_columns = 0;
};

struct SampledBatch {
    RayBatch rays;
    TargetBatch targets;
    ColumnWindow window{};

    std::size_t frame_ray(std::uint32_t batch_ray_index) const;
};

/// Selects about train.rays_per_iteration rays of a frame, or all rays if this setting is
/// 0: every n-th group of RELIDAR_COLUMN_GROUP neighbouring columns, which visit the same
/// tree nodes; one window of neighbouring columns if a loss compares neighbouring pixels;
/// in a frame without image order, every n-th ray.
class BatchSampler {
public:
    /// @throws UsageError if a loss needs images, but the rays are not ordered as images
    BatchSampler(Device& device, const Config& config, const std::vector<TrainingFrameData>& frames);
    SampledBatch draw_batch(Stream& stream, const TrainingFrameData& frame, Random& random);
    /// Returns a batch of a series, whose batches together contain all rays of a frame,
    /// except a few columns at the end of a full turn. A window is a series of one batch.
    /// @param start  of the first batch, from draw_start()
    /// @param index  below count_batches()
    SampledBatch gather(Stream& stream, const TrainingFrameData& frame, std::uint32_t start,
                        std::uint32_t index);
    /// Draws the first column (or ray) of a batch.
    std::uint32_t draw_start(const TrainingFrameData& frame, Random& random) const;
    /// Number of batches of a series.
    std::uint32_t count_batches(const TrainingFrameData& frame) const;

private:
    std::uint32_t n_rays_;   ///< about the number of rays of a batch; 0: all rays
    bool windows_;           ///< true: batches are windows of neighbouring columns
    Array<DeviceRay> rays_;  ///< rays of the last batch that was copied
    Array<DeviceTarget> targets_;
    Kernel<shared::GatherColumnsParams> gather_;

    BatchPlan plan(const TrainingFrameData& frame) const;
    SampledBatch copy_columns(Stream& stream, const TrainingFrameData& frame, const BatchPlan& batches,
                              std::uint32_t first_column);
};

}  // namespace relidar
