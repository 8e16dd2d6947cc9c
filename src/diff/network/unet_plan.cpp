// SPDX-License-Identifier: Apache-2.0
// Computes the offsets and initial values of a network's parameters. The constructor of
// UnetLayout assigns the offsets in the order of its calls. Each group of
// parameters starts at a multiple of four floats, because arrays on the device need this
// alignment.
#include <cmath>
#include <random>

#include "diff/network/unet.hpp"

namespace relidar::network {
namespace {

std::size_t reserve_floats(std::size_t& n_allocated, std::size_t n_floats) {
    const std::size_t first = n_allocated;
    n_allocated += (n_floats + 3) / 4 * 4;
    return first;
}

}  // namespace

UnetLayout::UnetLayout(const RayDropNetwork& network) {
    // Weights [n_out, n_in, taps], then the biases if there are any.
    const auto conv = [&](std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps, bool biased) {
        ConvOffsets layer{
            n_in, n_out, taps, reserve_floats(n_parameters, std::size_t(n_in) * n_out * taps), {}};
        if (biased) layer.bias = reserve_floats(n_parameters, n_out);
        return layer;
    };
    // Normalisation, then a convolution without bias. Each channel has the values
    // (beta, gamma) and running (mean, variance).
    const auto block = [&](std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps) {
        return BlockOffsets{reserve_floats(n_parameters, 2 * n_in), reserve_floats(n_running, 2 * n_in),
                            conv(n_in, n_out, taps, false)};
    };
    const std::vector<std::uint32_t>& w = network.widths;
    const std::size_t n_levels = w.size() - 1;
    first_conv = conv(std::uint32_t(network.inputs.size()), w[0], 1, true);
    for (std::size_t l = 1; l <= n_levels; ++l) {
        down.push_back(block(w[l - 1], w[l], network.taps));
        down.push_back(block(w[l], w[l], network.taps));
    }
    if (network.heads > 0) {
        query = block(w[n_levels], 3 * w[n_levels], 1);
        project = conv(w[n_levels], w[n_levels], 1, true);
    }
    // A network with one level also has decoder blocks.
    for (std::size_t l = 0; l < std::max<std::size_t>(n_levels, 1); ++l) {
        const std::uint32_t joined = joined_channels(w, l);
        up.push_back(block(joined, joined, network.taps));
        up.push_back(block(joined, decoder_channels(w, l), network.taps));
    }
    last_conv = conv(w[0], 1, 1, true);
}

std::uint32_t decoder_channels(const std::vector<std::uint32_t>& widths, std::size_t level) {
    return level == 0 ? widths[0] : widths[level] / 2;
}

std::uint32_t upsampled_channels(const std::vector<std::uint32_t>& widths, std::size_t level) {
    const std::size_t n_levels = widths.size() - 1;
    if (level >= n_levels) return 0;
    return level + 1 == n_levels ? widths[n_levels] : decoder_channels(widths, level + 1);
}

std::uint32_t joined_channels(const std::vector<std::uint32_t>& widths, std::size_t level) {
    return upsampled_channels(widths, level) + widths[level];
}

void init_parameters(RayDropNetwork& network, const UnetLayout& layout, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    network.parameters.assign(layout.n_parameters, 0.0f);
    network.running.assign(layout.n_running, 0.0f);
    const auto draw_conv = [&](const ConvOffsets& layer) {
        const float bound = std::sqrt(6.0f / float(layer.n_in * layer.taps));
        for (std::size_t i = 0; i < std::size_t(layer.n_in) * layer.n_out * layer.taps; ++i) {
            // Random number between -1 and 1. std::uniform_real_distribution is not used,
            // because its numbers depend on the compiler.
            const float uniform = float(random() >> 40) * 0x1p-23f - 1.0f;
            network.parameters[layer.weights + i] = bound * uniform;
        }
    };
    const auto draw_block = [&](const BlockOffsets& block) {
        for (std::size_t c = 0; c < block.conv.n_in; ++c) {
            network.parameters[block.beta_gamma + 2 * c + 1] = 1.0f;
            network.running[block.running + 2 * c + 1] = 1.0f;
        }
        draw_conv(block.conv);
    };
    draw_conv(layout.first_conv);
    for (const BlockOffsets& block : layout.down) draw_block(block);
    // Leaves the output projection of the attention at 0, so that attention adds nothing
    // at first.
    if (layout.query) draw_block(*layout.query);
    for (const BlockOffsets& block : layout.up) draw_block(block);
    if (!network.residual) draw_conv(layout.last_conv);
}

}  // namespace relidar::network
