// SPDX-License-Identifier: Apache-2.0
#include "train/frames/batch.hpp"

#include <algorithm>

#include <relidar/base/error.hpp>

#include "gpu/stream.hpp"
#include "train/frames/frame_data.hpp"
#include "train/shared/train.h"

namespace relidar {

/// Columns of a frame that form a batch: every stride-th group of neighbouring columns,
/// or a window of neighbouring columns if the stride is 1.
struct StridedColumns {
    std::uint32_t stride = 1;
    std::uint32_t n = 0;  ///< number of columns; 0 if the batch does not consist of columns
};

struct BatchSampler::Impl {
    TrainConfig config;
    bool windows;  ///< true: batches are windows of neighbouring columns
    Array<DeviceRay> rays;
    Array<DeviceTarget> targets;
    Kernel<shared::GatherColumnsParams> gather;

    SampledBatch copy_columns(Stream& stream, const TrainingFrameData& frame, const StridedColumns& columns,
                              std::uint32_t first_column);
};

namespace {

/// Returns n if every n-th ray of the frame gives a batch of about rays_per_iteration
/// rays. A setting of 0 means all rays.
std::uint32_t ray_stride(const TrainingFrameData& frame, const TrainConfig& config) {
    const std::uint32_t n_rays = static_cast<std::uint32_t>(config.rays_per_iteration);
    return n_rays == 0 ? 1u : std::max(1u, frame.n_rays / n_rays);
}

/// If the rays are not ordered as an image, the frame has a single row.
ImageShape image_shape(const TrainingFrameData& frame) {
    return frame.image.is_image() ? frame.image : ImageShape{1, frame.n_rays, false};
}

/// Returns which columns of a frame form a batch of about rays_per_iteration rays.
/// @param contiguous  true: one window of neighbouring columns, for losses that compare
/// neighbouring pixels
StridedColumns choose_columns(const TrainingFrameData& frame, const TrainConfig& config, bool contiguous) {
    const StridedColumns no_columns{};
    if (config.rays_per_iteration == 0) return no_columns;
    if (contiguous) {
        const ImageShape image = image_shape(frame);
        const auto n_rays = static_cast<std::uint32_t>(config.rays_per_iteration);
        // The number of full columns that is nearest to n_rays.
        const std::uint32_t rounded = (n_rays + image.rows / 2) / image.rows;
        const std::uint32_t n_columns = std::clamp(rounded, 1u, image.columns);
        return n_columns < image.columns ? StridedColumns{.stride = 1, .n = n_columns} : no_columns;
    }
    // Selects every n-th group of neighbouring columns. The rays of a group have similar
    // directions, so they are traced faster.
    const std::uint32_t stride = std::min(ray_stride(frame, config), frame.image.columns);
    if (!frame.image.is_image() || stride <= 1) return no_columns;
    return {.stride = stride, .n = frame.image.columns / stride};
}

/// Returns the number of rays of the largest batch that consists of columns. Such a batch
/// is copied to separate arrays.
std::size_t max_column_rays(const std::vector<TrainingFrameData>& frames, const Config& config) {
    std::size_t most = 0;
    for (const TrainingFrameData& frame : frames) {
        const StridedColumns columns = choose_columns(frame, config.train, config.has_pixel_pair_loss());
        most = std::max(most, std::size_t(image_shape(frame).rows) * columns.n);
    }
    return most;
}

}  // namespace

/// Allocates arrays for the largest batch that consists of columns, which a kernel
/// copies. Other batches use the arrays of their frame.
BatchSampler::BatchSampler(Device& device, const Config& config, const std::vector<TrainingFrameData>& frames)
    : impl_(new Impl{.config = config.train,
                     .windows = config.has_pixel_pair_loss(),
                     .rays = {device, max_column_rays(frames, config), "batch rays"},
                     .targets = {device, max_column_rays(frames, config), "batch targets"},
                     .gather = {device, "train/gather_columns"}}) {
    const bool needs_images = config.loss.intensity * config.loss.intensity_ssim > 0.0f;
    const auto is_image = [](const TrainingFrameData& frame) { return frame.image.is_image(); };
    if (needs_images && !std::ranges::all_of(frames, is_image))
        throw UsageError(
            "setting loss.intensity_ssim: the rays of this sensor are not ordered in rows and columns, so "
            "this loss cannot be computed; set it to 0");
}

BatchSampler::~BatchSampler() = default;

/// Converts the index of a ray in the batch to its index in the frame. Must select the
/// same columns as frame_column() in shaders/train/columns.glsl.
std::size_t SampledBatch::frame_ray(std::uint32_t batch_ray_index) const {
    if (window.columns == 0) return rays.first + std::size_t(batch_ray_index) * rays.stride;
    const std::uint32_t row = batch_ray_index / window.n_columns, column = batch_ray_index % window.n_columns;
    // RELIDAR_COLUMN_GROUP neighbouring columns form a group. Group k of the batch is
    // group k * stride of the frame, counted from the column window.first.
    const std::uint32_t column_of_group = column % RELIDAR_COLUMN_GROUP;
    const std::uint32_t group_column = (column - column_of_group) * window.stride;
    return std::size_t(row) * window.columns +
           (window.first + group_column + column_of_group) % window.columns;
}

std::uint32_t BatchSampler::count_batches(const TrainingFrameData& frame) const {
    const StridedColumns columns = choose_columns(frame, impl_->config, impl_->windows);
    return columns.n > 0 || impl_->windows ? columns.stride : ray_stride(frame, impl_->config);
}

/// Draws the first column of a batch, or its first ray if it does not consist of columns.
std::uint32_t BatchSampler::draw_column(const TrainingFrameData& frame, Random& random) const {
    const StridedColumns columns = choose_columns(frame, impl_->config, impl_->windows);
    std::uint32_t choices = count_batches(frame);
    if (columns.n > 0) {
        const ImageShape image = image_shape(frame);
        // A window of columns must not extend beyond the last column, except in an image
        // that covers a full turn.
        choices = image.circular || columns.stride > 1 ? image.columns : image.columns - columns.n + 1;
    }
    return static_cast<std::uint32_t>(random.next_uint64() % choices);
}

SampledBatch BatchSampler::draw_batch(Stream& stream, const TrainingFrameData& frame, Random& random) {
    return gather(stream, frame, draw_column(frame, random), 0);
}

/// Returns batch `index` of a series. Losses of a batch are divided by n_returned or
/// n_known_rays. Both are expected numbers: the number in the full frame times the share
/// of its rays. The actual numbers would bias the loss, because a sector with few returns
/// would get a higher weight.
SampledBatch BatchSampler::gather(Stream& stream, const TrainingFrameData& frame, std::uint32_t column,
                                  std::uint32_t index) {
    const StridedColumns columns = choose_columns(frame, impl_->config, impl_->windows);
    if (columns.n > 0) {
        const std::uint32_t n_columns = image_shape(frame).columns;
        if (columns.stride > 1) column = (column + index * RELIDAR_COLUMN_GROUP) % n_columns;
        return impl_->copy_columns(stream, frame, columns, column);
    }
    // Every n-th ray. This batch needs no copy, because kernels read with a stride.
    const std::uint32_t stride = count_batches(frame);
    const std::uint32_t first_ray = (column + index) % stride;
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
SampledBatch BatchSampler::Impl::copy_columns(Stream& stream, const TrainingFrameData& frame,
                                              const StridedColumns& columns, std::uint32_t first_column) {
    const ImageShape image = image_shape(frame);
    const std::uint32_t n_rays = image.rows * columns.n;
    run(stream, gather, n_rays,
        {.rays = frame.device_rays().address(),
         .targets = frame.loss_targets().address(),
         .batch_rays = rays.address(),
         .batch_targets = targets.address(),
         .rows = image.rows,
         .columns = image.columns,
         .first_column = first_column,
         .column_stride = columns.stride,
         .n_columns = columns.n});
    const double share = double(n_rays) / frame.n_rays;
    return {.rays = {.rays = &rays, .n_rays = n_rays, .columns = columns.n, .targets = &targets},
            .targets = {.targets = &targets,
                        .n_rays = n_rays,
                        .n_returned = share * frame.n_returned,
                        .n_known_rays = share * frame.n_known_rays,
                        .image = {.rows = image.rows, .columns = columns.n}},
            .window = {.columns = image.columns,
                       .first = first_column,
                       .stride = columns.stride,
                       .n_columns = columns.n}};
}

}  // namespace relidar
