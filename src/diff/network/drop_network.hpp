// SPDX-License-Identifier: Apache-2.0
// Functions for both training and inference of the ray-drop network. They compute the
// shape of the network from the options, and they check images.
#pragma once

#include <cstdint>
#include <string>

#include <relidar/diff/network.hpp>

namespace relidar::network {

/// Returns a network without parameters, with the shape that the options describe.
/// @throws UsageError if the network is unknown, too wide or too deep, or the number of
/// heads does not divide the channels
RayDropNetwork make_network(const RayDropNetworkOptions& options);

int batch_size_of(const RayDropNetworkOptions& options);

/// Training settings that reduce overfitting. Small networks do not use them: dropout
/// hardly helps these networks, and rotated images make them less accurate.
struct NetworkRegularisation {
    double dropout = 0.0;  ///< share of the values that a layer drops
    /// True: training shifts images by a random number of columns, so that the scene
    /// rotates. Does not shift input channels that depend only on the sensor, or images
    /// that do not cover a full turn.
    bool turns = false;
};
NetworkRegularisation regularisation_of(const RayDropNetworkOptions& options);

std::uint32_t find_drop_channel(const RayDropNetwork& network);

/// Returns the number of input channels that are constant for the sensor (do not depend
/// on the scene). They are the last channels.
std::uint32_t count_fixed_channels(const RayDropNetwork& network);

/// Checks the size and the values of an image.
/// @param text text of the image for error messages
/// @throws DataError if the image has the wrong size or values that are not finite
void check_image(const RayDropNetwork& network, const RayDropImage& image, const std::string& text);

}  // namespace relidar::network
