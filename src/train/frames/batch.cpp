// SPDX-License-Identifier: Apache-2.0
#include "train/frames/batch.hpp"

#include <algorithm>

#include <relidar/base/error.hpp>

#include "gpu/stream.hpp"
#include "train/frames/frame_data.hpp"

namespace relidar {

/// How a frame is divided into batches. By default, one batch has all rays.
struct BatchPlan {
    /// Number of columns of a batch. 0 if a batch is every n_batches-th ray of the frame.
    std::uint32_t n_columns = 0;
    /// A batch has every n_batches-th ray, or group of columns. Together, they have all.
    std::uint32_t n_batches = 1;
    std::uint32_t n_starts = 1;  ///< number of columns (or rays) with which a batch can start
};

namespace {

/// If the rays are not ordered as an image, the frame has a single row.
ImageShape image_shape(const TrainingFrameData& frame) {
    return frame.image.is_image() ? frame.image : ImageShape{1, frame.n_rays, false};
}

/// Divides a frame into batches of about `n_rays` rays (0: all rays). A batch is a window
/// of columns, or else every n-th group of columns or, without an image, every n-th ray.
/// @param windows  true: windows of columns, because losses compare neighbouring pixels
BatchPlan plan_batches(const TrainingFrameData& frame, std::uint32_t n_rays, bool windows) {
    if (n_rays == 0) return {};
    if (windows) {
        const ImageShape image = image_shape(frame);
        const std::uint32_t nearest_count = (n_rays + image.rows / 2) / image.rows;
        const std::uint32_t n_columns = std::clamp(nearest_count, 1u, image.columns);
        if (n_columns == image.columns) return {};
        // Only in an image of a full turn can a window extend beyond the last column.
        return {.n_columns = n_columns,
                .n_starts = image.circular ? image.columns : image.columns - n_columns + 1};
    }
    const std::uint32_t ray_stride = std::max(1u, frame.n_rays / n_rays);
    // The rays of a group of columns have similar directions, so they are traced faster
    // than single rays. Any column can be the first.
    const std::uint32_t column_stride = std::min(ray_stride, frame.image.columns);
    if (frame.image.is_image() && column_stride > 1)
        return {.n_columns = frame.image.columns / column_stride,
                .n_batches = column_stride,
                .n_starts = frame.image.columns};
    return {.n_batches = ray_stride, .n_starts = ray_stride};
}

/// Returns the number of rays of the largest batch that consists of columns.
std::size_t max_column_rays(const std::vector<TrainingFrameData>& frames, std::uint32_t n_rays,
                            bool windows) {
    std::size_t most = 0;
    for (const TrainingFrameData& frame : frames)
        most = std::max(
            most, std::size_t(image_shape(frame).rows) * plan_batches(frame, n_rays, windows).n_columns);
    return most;
}

}  // namespace

/// Allocates arrays for the largest batch that consists of columns, because a kernel
/// copies these columns. A batch of every n-th ray uses the arrays of its frame.
BatchSampler::BatchSampler(Device& device, const Config& config, const std::vector<TrainingFrameData>& frames)
    : n_rays_(static_cast<std::uint32_t>(config.train.rays_per_iteration)),
      windows_(config.has_pixel_pair_loss()),
      rays_(device, max_column_rays(frames, n_rays_, windows_), "batch rays"),
      targets_(device, rays_.size(), "batch targets"),
      gather_(device, "train/gather_columns") {
    const auto is_image = [](const TrainingFrameData& frame) { return frame.image.is_image(); };
    if (windows_ && !std::ranges::all_of(frames, is_image))
        throw UsageError(
            "setting loss.intensity_ssim: the rays of this sensor are not ordered in rows and columns, so "
            "this loss cannot be computed; set it to 0");
}

BatchPlan BatchSampler::plan(const TrainingFrameData& frame) const {
    return plan_batches(frame, n_rays_, windows_);
}

/// Converts the index of a ray in the batch to its index in the frame. Rays are sorted by
/// row. Must select the same columns as frame_column() in shaders/train/columns.glsl.
std::size_t SampledBatch::frame_ray(std::uint32_t batch_ray_index) const {
    const bool has_every_nth_ray = window.columns == 0;
    if (has_every_nth_ray) return rays.first + std::size_t(batch_ray_index) * rays.stride;
    const std::uint32_t row = batch_ray_index / window.n_columns, column = batch_ray_index % window.n_columns;
    // RELIDAR_COLUMN_GROUP neighbouring columns form a group. Group k of the batch is
    // group k * stride of the frame, counted from the column window.first.
    const std::uint32_t column_in_group = column % RELIDAR_COLUMN_GROUP;
    const std::uint32_t first_of_group = (column - column_in_group) * window.stride;
    const std::uint32_t frame_column = (window.first + first_of_group + column_in_group) % window.columns;
    return std::size_t(row) * window.columns + frame_column;
}

std::uint32_t BatchSampler::count_batches(const TrainingFrameData& frame) const {
    return plan(frame).n_batches;
}

std::uint32_t BatchSampler::draw_start(const TrainingFrameData& frame, Random& random) const {
    return static_cast<std::uint32_t>(random.next_uint64() % plan(frame).n_starts);
}

SampledBatch BatchSampler::draw_batch(Stream& stream, const TrainingFrameData& frame, Random& random) {
    return gather(stream, frame, draw_start(frame, random), 0);
}

/// Losses of a batch are divided by n_returned or n_known_rays. Both are expected
/// numbers: the number in the full frame times the share of its rays. The actual numbers
/// would bias the loss, because a sector with few returns would get a higher weight.
SampledBatch BatchSampler::gather(Stream& stream, const TrainingFrameData& frame, std::uint32_t start,
                                  std::uint32_t index) {
    const BatchPlan batches = plan(frame);
    if (batches.n_columns > 0) {
        const std::uint32_t first_column = start + index * RELIDAR_COLUMN_GROUP;
        return copy_columns(stream, frame, batches, first_column % image_shape(frame).columns);
    }
    // Every n-th ray. This batch needs no copy, because kernels read with a stride.
    const std::uint32_t stride = batches.n_batches, first_ray = (start + index) % stride;
    const RayBatch rays = frame.strided_batch(first_ray, stride);
    return {.rays = rays,
            .targets = {.targets = &frame.loss_targets(),
                        .first = first_ray,
                        .stride = stride,
                        .n_rays = rays.n_rays,
                        .n_returned = frame.n_returned / stride,
                        .n_known_rays = frame.n_known_rays / stride,
                        .image = stride == 1 ? frame.image : ImageShape{}}};
}

/// Copies columns of a frame to the batch arrays, which then contain only these rays.
SampledBatch BatchSampler::copy_columns(Stream& stream, const TrainingFrameData& frame,
                                        const BatchPlan& batches, std::uint32_t first_column) {
    const ImageShape image = image_shape(frame);
    const ColumnWindow window{.columns = image.columns,
                              .first = first_column,
                              .stride = batches.n_batches,
                              .n_columns = batches.n_columns};
    const std::uint32_t n_batch_rays = image.rows * window.n_columns;
    run(stream, gather_, n_batch_rays,
        {.rays = frame.device_rays().address(),
         .targets = frame.loss_targets().address(),
         .batch_rays = rays_.address(),
         .batch_targets = targets_.address(),
         .rows = image.rows,
         .columns = window.columns,
         .first_column = window.first,
         .column_stride = window.stride,
         .n_columns = window.n_columns});
    const double share = double(n_batch_rays) / frame.n_rays;
    return {
        .rays = {.rays = &rays_, .n_rays = n_batch_rays, .columns = window.n_columns, .targets = &targets_},
        .targets = {.targets = &targets_,
                    .n_rays = n_batch_rays,
                    .n_returned = share * frame.n_returned,
                    .n_known_rays = share * frame.n_known_rays,
                    .image = {.rows = image.rows, .columns = window.n_columns}},
        .window = window};
}

}  // namespace relidar
