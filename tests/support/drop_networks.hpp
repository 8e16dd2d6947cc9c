// SPDX-License-Identifier: Apache-2.0
// Makes ray-drop networks with fixed weights that need no training.
#pragma once

#include <algorithm>
#include <cstdint>

#include <relidar/diff/network.hpp>

#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar::test {

/// Returns a network with random weights that processes each pixel separately. Its output
/// depends on all of its inputs.
inline RayDropNetwork make_network_of_rays(std::uint64_t seed = 1) {
    RayDropNetworkOptions options;
    options.network = "pixel";
    RayDropNetwork network = network::make_network(options);
    const network::UnetLayout plan(network);
    network.residual = false;
    network::init_parameters(network, plan, seed);
    network.residual = true;
    for (std::size_t c = 0; c < network.inputs.size(); ++c)
        network.normalisation.insert(network.normalisation.end(), {1.0f, 0.0f});
    return network;
}

/// Returns a network that predicts a return for every ray.
inline RayDropNetwork make_network_that_never_drops() {
    RayDropNetwork network = make_network_of_rays();
    std::fill(network.normalisation.begin(), network.normalisation.end(), 0.0f);
    // a bias of -40 dominates the output, because rendered logits are between -9.3 and
    // 9.3
    network.parameters[*network::UnetLayout(network).last_conv.bias] = -40.0f;
    return network;
}

}  // namespace relidar::test
