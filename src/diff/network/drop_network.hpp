// SPDX-License-Identifier: Apache-2.0
// What training and asking a network have in common: its shape from the options, checks
// of networks and images.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/diff/network.hpp>

namespace relidar::refine {

/// A network of the options' shape without parameters. @throws UsageError for more
/// channels or levels than make sense
DropNetwork shape_of(const RefineOptions& options);

/// Returns the number of images in a training step. @throws UsageError for an unknown
/// network
int batch_of(const RefineOptions& options);

/// What keeps a network in training from knowing its images by heart. Little helps small
/// networks, and turning them cost accuracy.
struct Regularisation {
    double dropout = 0.0;  ///< share of the values that a layer drops
    /// images are turned about the sensor by random columns; what belongs to its pixels
    /// stays
    bool turns = false;
};
/// @throws UsageError for an unknown network
Regularisation regularisation_of(const RefineOptions& options);

/// Number of the input that is the rendered drop logit.
std::uint32_t logit_channel(const DropNetwork& network);

/// Inputs at the end that belong to the sensor's pixels.
std::uint32_t fixed_channels(const DropNetwork& network);

/// @param what  the image in messages @throws DataError where the image does not fit the
/// network, or holds what is not finite
void check_image(const DropNetwork& network, const DropImage& image, const std::string& what);

}  // namespace relidar::refine
