// SPDX-License-Identifier: Apache-2.0
// Stores training images on the device. Copies selected images into batches, which are
// normalised and rotated around the sensor.
#pragma once

#include <span>
#include <vector>

#include <relidar/diff/network.hpp>

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

/// Returns scale and shift of each input channel, [channels, 2]. They convert a channel
/// to mean 0 and standard deviation 1 over all images. A constant channel becomes 0.
std::vector<float> channel_scaling(const std::vector<RayDropImage>& images, std::size_t n_channels);

/// An image of a batch, and the number of columns by which its scene is rotated.
struct RotatedSample {
    std::uint32_t sample = 0, column_shift = 0;
};

class RayDropInputs {
public:
    RayDropInputs(Device& device, const RayDropNetwork& network);

    void upload_images(Device& device, std::span<const RayDropImage> images);

    void fill_batch(Stream& stream, std::span<const RotatedSample> chosen, const Tensor& to);
    /// Submits the kernel that creates a batch from images that are already on the
    /// device. Does not update measured_drops(), because it is unknown which rays of
    /// these images were dropped (had no return).
    /// @param samples device address of images, [samples, channels, rows, columns]
    void fill_batch(Stream& stream, std::span<const RotatedSample> chosen,
                    Address<float, shared::DropSamples> samples, const Tensor& to);

    /// Returns the rendered ray-drop probabilities of the last batch as logits, [n, rows,
    /// columns]. A network with `residual` predicts a correction that is added to these
    /// logits.
    const Array<float, shared::StartLogits>& rendered_logits() const { return start_; }
    /// Returns which rays of the last batch were dropped (had no return) in the log, [n,
    /// rows, columns]. Same values as RayDropImage::dropped.
    const Array<float, shared::DropTargets>& measured_drops() const { return target_; }
    bool has_measured() const { return targets_.size() > 0; }
    std::size_t count_known(std::uint32_t image_index) const { return n_known_pixels_[image_index]; }

private:
    std::uint32_t n_channels_, n_fixed_, logit_channel_;
    Kernel<shared::DropInputsParams> kernel_;
    Array<float, shared::DropSamples> samples_;
    Array<float, shared::SampleTargets> targets_;
    Array<float, shared::StartLogits> start_;
    Array<float, shared::DropTargets> target_;
    Array<glm::vec2> scale_shift_;
    std::vector<std::size_t> n_known_pixels_;

    void fill_batch(Stream& stream, std::span<const RotatedSample> chosen, shared::DropInputsParams params,
                    const Tensor& to);
};

}  // namespace relidar::network
