// SPDX-License-Identifier: Apache-2.0
// Asking a ray-drop network about images that are on the device already.
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

/// Compiles every pipeline that training and evaluating the options' network use. Runs
/// none of them.
void compile_drop_network(Device& device, const RefineOptions& options);

/// A network in evaluation mode, as DropRefiner, in a stream of the caller's.
class DropPass {
public:
    /// @throws as DropRefiner
    DropPass(Device& device, const DropNetwork& network);
    ~DropPass();

    const DropNetwork& network() const;
    /// Records a pass over one image. @param channels [network().inputs, rows, columns]
    /// as DropImage::channels
    /// @return [rows, columns] drop probabilities, there until an image of a third shape
    /// @throws DataError for an image smaller than network().smallest_side()
    const Array<float, shared::DropProbabilities>& run(Stream& stream, int rows, int columns,
                                                       const Array<float, shared::DropSamples>& channels);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
