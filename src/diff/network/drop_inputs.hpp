// SPDX-License-Identifier: Apache-2.0
// Images that wait on the device, and batches of them, normalised and turned.
#pragma once

#include <span>
#include <vector>

#include <relidar/diff/network.hpp>

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Scale and shift [channels, 2] by which each input has mean 0 and deviation 1 over the
/// images; one that never changes is 0.
std::vector<float> normalisation_of(const std::vector<DropImage>& images, std::size_t n_channels);

class DropInputs {
public:
    DropInputs(Device& device, const DropNetwork& network);

    /// Puts images on the device in place of those that were there. @param images  of one
    /// shape, checked
    void keep(Device& device, std::span<const DropImage> images);

    /// An image, and by how many columns what it shows is turned.
    struct Chosen {
        std::uint32_t sample = 0, turn = 0;
    };
    /// Records the making of a batch of the images that are kept. @param images [n,
    /// channels, rows, columns] output
    void make(Stream& stream, std::span<const Chosen> chosen, const Tensor& images);
    /// The same of images that somebody else keeps, without targets. @param samples
    /// [samples, channels, rows, columns]
    void make(Stream& stream, std::span<const Chosen> chosen, Address<float, shared::DropSamples> samples,
              const Tensor& images);

    /// [n, rows, columns] rendered logits of the last batch
    const Array<float, shared::StartLogits>& start() const { return start_; }
    /// [n, rows, columns]; as DropImage::dropped
    const Array<float, shared::DropTargets>& target() const { return target_; }
    bool has_targets() const { return targets_.size() > 0; }
    /// pixels of an image whose target is known
    std::size_t known(std::uint32_t sample) const { return known_[sample]; }

private:
    std::uint32_t n_channels_, n_fixed_, logit_channel_;
    Kernel<shared::DropInputsParams> kernel_;
    Array<float, shared::DropSamples> samples_;
    Array<float, shared::SampleTargets> targets_;
    Array<float, shared::StartLogits> start_;
    Array<float, shared::DropTargets> target_;
    Array<glm::vec2> scale_shift_;
    std::vector<std::size_t> known_;

    void make(Stream& stream, std::span<const Chosen> chosen, shared::DropInputsParams params,
              const Tensor& images);
};

}  // namespace relidar::refine
