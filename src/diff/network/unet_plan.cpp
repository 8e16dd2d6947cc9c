// SPDX-License-Identifier: Apache-2.0
// Computes the offsets and initial values of a network's parameters. Groups of them start
// at multiples of four floats, because device arrays need this alignment.
#include <cmath>
#include <random>

#include "diff/network/unet.hpp"

namespace relidar::network {
namespace {

/// Returns the offset of a new group of floats, and adds the group to `n_allocated`.
std::size_t reserve_floats(std::size_t& n_allocated, std::size_t n_floats) {
    const std::size_t first = n_allocated;
    n_allocated += (n_floats + 3) / 4 * 4;
    return first;
}

/// Draws the weights of a convolution with Kaiming's initialisation: uniform between
/// -bound and bound, where bound = sqrt(6 / number of inputs of an output value). The
/// values then keep their variance from layer to layer.
void draw_conv_weights(std::vector<float>& parameters, const ConvOffsets& layer, std::mt19937_64& random) {
    const float bound = std::sqrt(6.0f / float(layer.n_in * layer.taps));
    for (std::size_t i = 0; i < std::size_t(layer.n_in) * layer.n_out * layer.taps; ++i) {
        // Uses the upper 24 bits, which a float represents exactly. The numbers of
        // std::uniform_real_distribution would depend on the compiler.
        const float uniform = float(random() >> 40) * 0x1p-23f - 1.0f;  // from -1 to 1
        parameters[layer.weights + i] = bound * uniform;
    }
}

/// Returns the number of output channels of a decoder level.
std::uint32_t decoder_channels(const std::vector<std::uint32_t>& widths, std::size_t level) {
    return level == 0 ? widths[0] : widths[level] / 2;
}

/// Returns the number of output channels of the level below a level. The smallest level
/// has no decoder, so its output is that of its encoder.
std::uint32_t channels_below(const std::vector<std::uint32_t>& widths, std::size_t level) {
    const std::size_t smallest = widths.size() - 1;
    if (level >= smallest) return 0;
    return level + 1 == smallest ? widths[smallest] : decoder_channels(widths, level + 1);
}

/// Initialises a block: its normalisation changes nothing at first (beta and mean 0,
/// gamma and variance 1), and the weights of its convolution are random.
void init_block(RayDropNetwork& network, const BlockOffsets& block, std::mt19937_64& random) {
    for (std::size_t channel = 0; channel < block.conv.n_in; ++channel) {
        network.parameters[block.beta_gamma + 2 * channel + 1] = 1.0f;
        network.running[block.running + 2 * channel + 1] = 1.0f;
    }
    draw_conv_weights(network.parameters, block.conv, random);
}

}  // namespace

/// Reserves the parameters of a convolution without bias.
ConvOffsets UnetLayout::add_conv(std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps) {
    const std::size_t n_weights = std::size_t(n_in) * n_out * taps;
    return {.n_in = n_in,
            .n_out = n_out,
            .taps = taps,
            .weights = reserve_floats(n_parameters, n_weights),
            .bias = {}};
}

ConvOffsets UnetLayout::add_biased_conv(std::uint32_t n_in, std::uint32_t n_out) {
    ConvOffsets layer = add_conv(n_in, n_out, 1);
    layer.bias = reserve_floats(n_parameters, n_out);
    return layer;
}

/// Reserves the parameters of a block. Its normalisation has the pairs (beta, gamma) and
/// running (mean, variance) of each input channel.
BlockOffsets UnetLayout::add_block(std::uint32_t n_in, std::uint32_t n_out, std::uint32_t taps) {
    BlockOffsets block;
    block.beta_gamma = reserve_floats(n_parameters, 2 * n_in);
    block.running = reserve_floats(n_running, 2 * n_in);
    block.conv = add_conv(n_in, n_out, taps);
    return block;
}

/// Assigns the offsets of all layers, from the input to the output. Files of trained
/// networks depend on this order.
UnetLayout::UnetLayout(const RayDropNetwork& network) {
    const std::vector<std::uint32_t>& widths = network.widths;  // number of channels of each level
    const std::size_t n_levels = widths.size() - 1;             // levels below the full image size
    const std::uint32_t smallest_width = widths[n_levels];

    first_conv = add_biased_conv(std::uint32_t(network.inputs.size()), widths[0]);
    for (std::size_t level = 1; level <= n_levels; ++level) {
        down.push_back({add_block(widths[level - 1], widths[level], network.taps),
                        add_block(widths[level], widths[level], network.taps)});
    }
    if (network.heads > 0) {
        query = add_block(smallest_width, 3 * smallest_width, 1);  // also key and value
        project = add_biased_conv(smallest_width, smallest_width);
    }
    // A network with one level also has decoder blocks.
    for (std::size_t level = 0; level < std::max<std::size_t>(n_levels, 1); ++level) {
        n_upsampled.push_back(channels_below(widths, level));
        const std::uint32_t joined = n_upsampled.back() + widths[level];  // with the skip connection
        up.push_back({add_block(joined, joined, network.taps),
                      add_block(joined, decoder_channels(widths, level), network.taps)});
    }
    last_conv = add_biased_conv(widths[0], 1);
}

void init_parameters(RayDropNetwork& network, const UnetLayout& layout, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    network.parameters.assign(layout.n_parameters, 0.0f);
    network.running.assign(layout.n_running, 0.0f);
    draw_conv_weights(network.parameters, layout.first_conv, random);
    for (const BlockPair& blocks : layout.down)
        for (const BlockOffsets& block : blocks) init_block(network, block, random);
    // `layout.project`, the output of the attention, stays 0. So the attention adds
    // nothing at first.
    if (layout.query) init_block(network, *layout.query, random);
    for (const BlockPair& blocks : layout.up)
        for (const BlockOffsets& block : blocks) init_block(network, block, random);
    if (!network.residual) draw_conv_weights(network.parameters, layout.last_conv, random);
}

}  // namespace relidar::network
