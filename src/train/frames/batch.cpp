// SPDX-License-Identifier: Apache-2.0
// Runs the kernel train/gather_columns, which copies the rays of a batch from a frame.
#include "train/frames/batch.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "gpu/stream.hpp"
#include "train/frames/frame_data.hpp"
#include "train/shared/train.h"

namespace relidar {

struct BatchSampler::Impl {
    TrainConfig config;
    bool windows;  ///< true: batches are windows of neighbouring columns
    Array<DeviceRay> rays;
    Array<DeviceTarget> targets;
    Kernel<shared::GatherColumnsParams> gather;
};

namespace {

/// Selection of n columns of an image, spread over the image with a fixed stride.
struct Columns {
    std::uint32_t stride = 1;
    std::uint32_t n = 0;  ///< number of columns; 0 if the batch does not consist of columns
};

std::uint32_t choose_ray_stride(const FrameData& frame, const TrainConfig& config) {
    const std::uint32_t n_rays = static_cast<std::uint32_t>(config.rays_per_iteration);
    return n_rays == 0 ? 1u : std::max(1u, frame.n_rays / n_rays);
}

/// Returns the number of rows and columns of a full frame. If the rays are not ordered as
/// an image, the frame has a single row.
ImageShape get_frame_image(const FrameData& frame) {
    return frame.image.is_image() ? frame.image : ImageShape{1, frame.n_rays, false};
}

Columns choose_window(const FrameData& frame, const TrainConfig& config) {
    const ImageShape image = get_frame_image(frame);
    const std::uint32_t n =
        std::clamp((static_cast<std::uint32_t>(config.rays_per_iteration) + image.rows / 2) / image.rows, 1u,
                   image.columns);
    return n < image.columns ? Columns{1, n} : Columns{};
}

/// Selects every n-th group of neighbouring columns. In a group, neighbouring rays have
/// similar directions and are traced faster.
Columns choose_every_nth(const FrameData& frame, const TrainConfig& config) {
    const std::uint32_t stride = std::min(choose_ray_stride(frame, config), frame.image.columns);
    return frame.image.is_image() && stride > 1 ? Columns{stride, frame.image.columns / stride} : Columns{};
}

Columns choose_columns_of_batch(const FrameData& frame, const TrainConfig& config, bool windows) {
    if (config.rays_per_iteration == 0) return {};
    return windows ? choose_window(frame, config) : choose_every_nth(frame, config);
}

/// Returns the number of rays in the largest batch that is copied column by column.
std::size_t find_largest_gathered_batch(const std::vector<FrameData>& frames, const Config& config) {
    std::size_t largest = 0;
    for (const FrameData& frame : frames)
        largest =
            std::max(largest, std::size_t(get_frame_image(frame).rows) *
                                  choose_columns_of_batch(frame, config.train, config.needs_images()).n);
    return largest;
}

/// Checks that the rays of all frames are ordered as an image.
/// @param setting  name of the setting that needs images, for the error message
/// @throws UsageError if a frame is not an image
void check_images(const char* setting, const std::vector<FrameData>& frames) {
    for (const FrameData& frame : frames)
        if (!frame.image.is_image())
            throw UsageError(fmt::format(
                "setting {}: the rays of this sensor are not ordered in rows and columns, so this loss "
                "cannot be computed; set it to 0",
                setting));
}

}  // namespace

BatchSampler::BatchSampler(Device& device, const Config& config, const std::vector<FrameData>& frames)
    : impl_(new Impl{config.train,
                     config.needs_images(),
                     {device, find_largest_gathered_batch(frames, config), "batch rays"},
                     {device, find_largest_gathered_batch(frames, config), "batch targets"},
                     {device, "train/gather_columns"}}) {
    if (config.loss.intensity * config.loss.intensity_ssim > 0.0f)
        check_images("loss.intensity_ssim", frames);
}
BatchSampler::~BatchSampler() = default;

/// This function and get_frame_column() in shaders/train/columns.glsl select the same
/// columns. Change both together.
std::size_t SampledBatch::get_ray_of_frame(std::uint32_t index) const {
    if (window.columns == 0) return rays.first + std::size_t(index) * rays.stride;
    const std::uint32_t row = index / window.n_columns, column = index % window.n_columns,
                        within = column % RELIDAR_COLUMN_GROUP;
    return std::size_t(row) * window.columns +
           (window.first + (column - within) * window.stride + within) % window.columns;
}

std::uint32_t BatchSampler::n_batches(const FrameData& frame) const {
    const Columns columns = choose_columns_of_batch(frame, impl_->config, impl_->windows);
    return columns.n > 0 || impl_->windows ? columns.stride : choose_ray_stride(frame, impl_->config);
}

std::uint32_t BatchSampler::draw_first(const FrameData& frame, Random& random) const {
    const Columns columns = choose_columns_of_batch(frame, impl_->config, impl_->windows);
    std::uint32_t choices = n_batches(frame);
    if (columns.n > 0) {
        const ImageShape image = get_frame_image(frame);
        // In an image that is not a full turn, a window of columns must not continue past
        // the last column.
        choices = image.circular || columns.stride > 1 ? image.columns : image.columns - columns.n + 1;
    }
    return static_cast<std::uint32_t>(random.next() % choices);
}

SampledBatch BatchSampler::sample(Stream& stream, const FrameData& frame, Random& random) {
    return take(stream, frame, draw_first(frame, random), 0);
}

SampledBatch BatchSampler::take(Stream& stream, const FrameData& frame, std::uint32_t first,
                                std::uint32_t index) {
    Impl& b = *impl_;
    const Columns columns = choose_columns_of_batch(frame, b.config, b.windows);
    if (columns.n > 0) {
        const ImageShape image = get_frame_image(frame);
        if (columns.stride > 1) first = (first + index * RELIDAR_COLUMN_GROUP) % image.columns;
        const std::uint32_t n = image.rows * columns.n;
        run(stream, b.gather, n,
            {.rays = frame.rays().address(),
             .targets = frame.targets().address(),
             .batch_rays = b.rays.address(),
             .batch_targets = b.targets.address(),
             .rows = image.rows,
             .columns = image.columns,
             .first_column = first,
             .column_stride = columns.stride,
             .n_columns = columns.n});
        // The loss is divided by a number of rays. Uses the count of the full frame times
        // the share of the batch, so that the loss is unbiased. With the count of the
        // batch, a sector with few returns would get a higher weight.
        const double share = double(n) / frame.n_rays;
        return {{&b.rays, 0, 1, n, columns.n, &b.targets},
                {&b.targets,
                 0,
                 1,
                 n,
                 share * frame.n_returned,
                 share * frame.n_known,
                 {image.rows, columns.n, false}},
                {image.columns, first, columns.stride, columns.n}};
    }
    const std::uint32_t stride = n_batches(frame);
    first = (first + index) % stride;
    const RayBatch rays = frame.batch(first, stride);
    return {rays,
            {&frame.targets(), first, stride, rays.n_rays, frame.n_returned / stride, frame.n_known / stride,
             stride == 1 ? frame.image : ImageShape{}},
            {}};
}

}  // namespace relidar
