// SPDX-License-Identifier: Apache-2.0
// Functions that both training and inference of the ray-drop network use. They compute
// its shape from the options and check images.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/diff/network.hpp>

namespace relidar::refine {

/// Returns a network with the shape that the options describe, but without parameters.
/// @throws UsageError if the network is unknown, too wide or too deep, or the number of
/// heads does not divide the channels
DropNetwork shape_of(const RefineOptions& options);

/// Returns the number of images per training step.
/// @throws UsageError if the network is unknown
int batch_of(const RefineOptions& options);

/// Training settings that reduce overfitting. Dropout has little effect for small
/// networks, and rotating the images reduced their accuracy.
struct Regularisation {
    double dropout = 0.0;  ///< share of the values that a layer drops
    /// True: training rotates images around the sensor by a random number of columns.
    /// Channels that belong to the sensor's pixels are not rotated.
    bool turns = false;
};
/// Returns the settings that reduce overfitting for a network.
/// @throws UsageError if the network is unknown
Regularisation regularisation_of(const RefineOptions& options);

/// Returns the index of the input channel that contains the rendered drop logit.
std::uint32_t logit_channel(const DropNetwork& network);

/// Returns the number of channels at the end of the input that belong to the sensor's
/// pixels.
std::uint32_t fixed_channels(const DropNetwork& network);

/// Checks the size and the values of an image.
/// @param what  description of the image for error messages
/// @throws DataError if the image does not fit the network or has values that are not
/// finite
void check_image(const DropNetwork& network, const DropImage& image, const std::string& what);

}  // namespace relidar::refine
