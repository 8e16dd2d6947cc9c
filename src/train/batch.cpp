// SPDX-License-Identifier: Apache-2.0
// Binding of train/gather_columns, and the two ways to take some rays of a frame.
#include "train/batch.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "gpu/stream.hpp"
#include "shared/train.h"
#include "train/frame_data.hpp"

namespace relidar {

static_assert(sizeof(shared::RayEntry) == sizeof(DeviceRay) && sizeof(shared::RayTarget) == sizeof(DeviceTarget));

struct BatchSampler::Impl {
    std::uint32_t wanted;   ///< rays; 0 = all
    bool columns;
    Array<DeviceRay> rays;
    Array<DeviceTarget> targets;
    Kernel<shared::GatherColumnsParams> gather;
};

namespace {

/// Image of a whole frame; one without image order is a row of rays.
ImageShape frame_image(const FrameData& frame) { return frame.image.is_image() ? frame.image : ImageShape{1, frame.n_rays, false}; }

std::uint32_t columns_of_batch(const FrameData& frame, std::uint32_t wanted) {
    const ImageShape image = frame_image(frame);
    return wanted == 0 ? image.columns : std::clamp((wanted + image.rows / 2) / image.rows, 1u, image.columns);
}

/// Rays of the largest window.
std::size_t largest_window(const std::vector<FrameData>& frames, const TrainConfig& train) {
    std::size_t largest = 0;
    if (train.batch != "columns") return largest;
    for (const FrameData& frame : frames)
        largest = std::max(largest, std::size_t(frame_image(frame).rows) * columns_of_batch(frame, static_cast<std::uint32_t>(train.rays_per_iteration)));
    return largest;
}

void check_images(const Config& config, const std::vector<FrameData>& frames) {
    if (!(config.loss.intensity * config.loss.intensity_ssim > 0.0f)) return;
    if (config.train.batch != "columns" && config.train.rays_per_iteration > 0)
        throw UsageError("setting loss.intensity_ssim: found batches of single rays, expected train.batch=columns or train.rays_per_iteration=0");
    for (const FrameData& frame : frames)
        if (!frame.image.is_image()) throw UsageError("setting loss.intensity_ssim: found a sensor without image order, expected rows and columns, or 0");
}

}  // namespace

BatchSampler::BatchSampler(Device& device, const Config& config, const std::vector<FrameData>& frames)
    : impl_(new Impl{static_cast<std::uint32_t>(config.train.rays_per_iteration),
                     config.train.batch == "columns",
                     {device, largest_window(frames, config.train), "batch rays"},
                     {device, largest_window(frames, config.train), "batch targets"},
                     {device, "train/gather_columns"}}) {
    check_images(config, frames);
}
BatchSampler::~BatchSampler() = default;

SampledBatch BatchSampler::sample(Stream& stream, const FrameData& frame, Random& random) {
    Impl& b = *impl_;
    const ImageShape image = frame_image(frame);
    const std::uint32_t n_columns = columns_of_batch(frame, b.wanted);
    if (b.columns && n_columns < image.columns) {
        const std::uint32_t first = static_cast<std::uint32_t>(random.next() % (image.circular ? image.columns : image.columns - n_columns + 1));
        const std::uint32_t n = image.rows * n_columns;
        run(stream, b.gather, n,
            {frame.rays.address(), frame.targets.address(), b.rays.address(), b.targets.address(), image.rows, image.columns, first, n_columns});
        const double share = double(n) / frame.n_rays;   // of the whole frame's count: unbiased, and no sector counts more for being empty
        return {{&b.rays, 0, 1, n, n_columns}, {&b.targets, 0, 1, n, share * frame.n_returned, share * frame.n_known, {image.rows, n_columns, false}}, {image.columns, first, n_columns}};
    }
    const std::uint32_t stride = b.columns || b.wanted == 0 ? 1u : std::max(1u, frame.n_rays / b.wanted);
    const std::uint32_t first = static_cast<std::uint32_t>(random.next() % stride);
    const RayBatch rays = frame.batch(first, stride);
    return {rays, {&frame.targets, first, stride, rays.n_rays, frame.n_returned / stride, frame.n_known / stride, stride == 1 ? frame.image : ImageShape{}}, {}};
}

}  // namespace relidar
