// SPDX-License-Identifier: Apache-2.0
// Applies a ray-drop network to images that are already on the device.
#pragma once

#include <memory>
#include <string>

#include <relidar/diff/network.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

namespace shared {
struct DropSamples;
struct DropProbabilities;
}  // namespace shared

/// Compiles all pipelines for training and evaluation of the network. Does not run them.
void compile_drop_network(Device& device, const RefineOptions& options);

/// Ray-drop network in evaluation mode. Its GPU commands are recorded in a stream that
/// the caller provides.
class DropPass {
public:
    /// Uploads the network to the device.
    /// @throws errors of the DropRefiner constructor
    DropPass(Device& device, const DropNetwork& network);
    ~DropPass();

    const DropNetwork& network() const;
    /// Records GPU commands that evaluate the network for one image.
    /// @param channels [network().inputs, rows, columns] as DropImage::channels
    /// @return drop probabilities, [rows, columns]. The result becomes invalid when
    /// images of two other shapes have been evaluated.
    /// @throws DataError if the image is smaller than network().smallest_side()
    const Array<float, shared::DropProbabilities>& run(Stream& stream, int rows, int columns,
                                                       const Array<float, shared::DropSamples>& channels);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
