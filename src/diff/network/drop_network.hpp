// SPDX-License-Identifier: Apache-2.0
// Shape, inputs on the device, and loss of the ray-drop network.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <relidar/diff/network.hpp>

#include "diff/network/layers.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

/// Returns a network without parameters, with the shape that the options describe.
/// @throws UsageError for an unknown network or a size that is not possible
RayDropNetwork make_network(const RayDropNetworkOptions& options);

int batch_size_of(const RayDropNetworkOptions& options);

/// Training settings that reduce overfitting. Small networks do not use them: dropout
/// hardly helps these networks, and rotated images make them less accurate.
struct NetworkRegularisation {
    double dropout = 0.0;  ///< share of the values that a layer drops
    /// True: training shifts images that cover a full turn by a random number of columns,
    /// so that the scene rotates, but not channels that depend only on the sensor.
    bool turns = false;
};
NetworkRegularisation regularisation_of(const RayDropNetworkOptions& options);

std::uint32_t find_drop_channel(const RayDropNetwork& network);

/// Returns the number of input channels that do not depend on the scene, the last ones.
std::uint32_t count_fixed_channels(const RayDropNetwork& network);

/// Checks the size and the values of an image.
/// @param text text of the image for error messages
/// @throws DataError if the image has the wrong size or values that are not finite
void check_image(const RayDropNetwork& network, const RayDropImage& image, const std::string& text);

/// Returns scale and shift of each input channel, [channels, 2]. They convert a channel
/// to mean 0 and standard deviation 1 over all images. A constant channel becomes 0.
std::vector<float> channel_scaling(const std::vector<RayDropImage>& images, std::size_t n_channels);

/// An image of a batch, and the number of columns by which its scene is rotated.
struct RotatedSample {
    std::uint32_t sample = 0, column_shift = 0;
};

/// Stores training images on the device. Copies selected images into batches, which are
/// normalised and rotated around the sensor.
class RayDropInputs {
public:
    RayDropInputs(Device& device, const RayDropNetwork& network);

    /// Uploads training images, and counts for each image the pixels whose measured drop
    /// is known.
    void upload_images(Device& device, std::span<const RayDropImage> images);

    /// Submits the kernel that creates a batch.
    /// @param chosen the images of the batch, and the rotation of each
    /// @param to receives the normalised images, [n, channels, rows, columns]
    /// @param samples device address of images, [samples, channels, rows, columns], or
    /// null for the uploaded images. Only uploaded images have measured drops
    void fill_batch(Stream& stream, std::span<const RotatedSample> chosen, const Tensor& to,
                    Address<float, shared::DropSamples> samples = {});

    /// Returns the rendered ray-drop probabilities of the last batch as logits, [n, rows,
    /// columns]. A network with `residual` predicts a correction of them.
    const Array<float, shared::StartLogits>& rendered_logits() const { return rendered_logits_; }
    /// Returns which rays of the last batch were dropped (had no return) in the log, [n,
    /// rows, columns]. Same values as RayDropImage::dropped.
    const Array<float, shared::DropTargets>& measured_drops() const { return batch_drops_; }
    std::size_t count_known(std::uint32_t image_index) const { return n_known_pixels_[image_index]; }

private:
    std::uint32_t n_channels_;
    std::uint32_t n_sensor_channels_;  ///< number of last channels that do not rotate with the scene
    std::uint32_t logit_channel_;      ///< rendered drop probability p, as log(p / (1 - p))
    Kernel<shared::DropInputsParams> kernel_;
    Array<float, shared::DropSamples> samples_;      ///< uploaded images
    Array<float, shared::SampleTargets> all_drops_;  ///< measured drops of uploaded images
    Array<float, shared::StartLogits> rendered_logits_;
    Array<float, shared::DropTargets> batch_drops_;
    Array<glm::vec2> scale_shift_;
    std::vector<std::size_t> n_known_pixels_;
};

struct RayDropScore {
    double entropy = 0.0;   ///< mean cross-entropy of the measured outcomes
    double accuracy = 0.0;  ///< Share of pixels whose predicted class (return or no return) is correct.
};

/// Arrays of n pixels that RayDropLoss reads and writes. Only `logit` must not be null.
struct RayDropLossArrays {
    Address<float, shared::DropLogits> logit;
    Address<float, shared::StartLogits> start = {};  ///< added to the logits
    /// 1 if the LiDAR measured no return for the ray, 0 if it measured a return, negative
    /// if unknown
    Address<float, shared::DropTargets> target = {};
    Address<float, shared::DropLogitGradients> d_logit = {};     ///< output: gradient of the logits
    Address<float, shared::DropProbabilities> probability = {};  ///< output: drop probabilities
};

/// Computes the probability that a ray has no return (ray drop) from the logits. Also
/// computes the cross-entropy loss and its derivative.
class RayDropLoss {
public:
    RayDropLoss(Device& device, std::size_t n_pixels);

    /// Submits the kernel that computes the loss and the arrays that are not null.
    /// @param n_known number of pixels with a known target; divides the derivative,
    /// because the loss is a mean
    void record_loss(Stream& stream, std::size_t n_pixels, const RayDropLossArrays& arrays,
                     std::size_t n_known);
    /// Returns the mean loss and accuracy of the last record_loss(), which the device
    /// must have finished.
    RayDropScore read_loss(std::size_t n_known_pixels) const;

private:
    static constexpr std::size_t kPixelsOfPart = 2048;

    std::uint32_t n_parts_, lanes_;
    Kernel<shared::DropLossParams> kernel_;
    Array<float, shared::PartSums> sums_;  ///< [parts, 2] cross-entropies, number of correct predictions
};

}  // namespace relidar::network
