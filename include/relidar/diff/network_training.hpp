// SPDX-License-Identifier: Apache-2.0
// Applies a ray-drop network to images that are already on the device.
#pragma once

#include <memory>

#include <relidar/diff/network.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

namespace shared {
struct DropSamples;
struct DropProbabilities;
}  // namespace shared

/// Compiles all pipelines for training and result of the network. Does not run them.
void compile_network(Device& device, const RayDropNetworkOptions& options);

/// Ray-drop network in result mode. Its GPU commands are recorded in a stream that
/// the caller provides.
class RayDropInference {
public:
    /// Uploads the network to the device.
    /// @throws errors of the RayDropRefiner constructor
    RayDropInference(Device& device, const RayDropNetwork& network);
    ~RayDropInference();

    const RayDropNetwork& network() const;
    /// Records GPU commands that evaluate the network for one image.
    /// @param circular true if the image covers a full turn (RayDropImage::circular)
    /// @param input_channels [network().inputs, rows, columns] in the layout of
    /// RayDropImage::channels
    /// @return drop probabilities, [rows, columns]. The object keeps one result array for
    /// each of the last two image sizes. A third image size invalidates the older array.
    /// @throws DataError if the image is smaller than network().min_image_size()
    const Array<float, shared::DropProbabilities>& record_drops(
        Stream& stream, int rows, int columns, bool circular,
        const Array<float, shared::DropSamples>& input_channels);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
