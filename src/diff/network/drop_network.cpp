// SPDX-License-Identifier: Apache-2.0
#include "diff/network/drop_network.hpp"

#include <algorithm>
#include <cmath>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace {

constexpr int kMostWidth = 512, kMostLevels = 6;

using network::NetworkRegularisation;

/// Predefined network architecture. Level l has width * factors[l] channels. Level 0 has
/// the full image size.
struct NetworkPreset {
    const char* name;
    std::uint32_t width;
    std::vector<std::uint32_t> factors;
    std::uint32_t heads = 0;  ///< attention heads
    std::uint32_t taps = 9;   ///< pixels of a convolution kernel: 9 (3x3) or 1 (no neighbours)
    bool residual = true;     ///< true: predicts a correction of the rendered drop logits
    int batch = 1;            ///< images per training step
    NetworkRegularisation in_training = {};
};

/// Returns the architecture that the setting refine.network selects: a small U-Net, a
/// network that processes each pixel separately, or the large U-Net of the paper.
const NetworkPreset& find_preset(const std::string& name) {
    static const NetworkPreset small{.name = "small", .width = 8, .factors = {1, 2, 4, 4}};
    static const NetworkPreset pixel{.name = "pixel", .width = 16, .factors = {1}, .taps = 1};
    static const NetworkPreset paper{.name = "paper",
                                     .width = 32,
                                     .factors = {1, 2, 4, 8, 8},
                                     .heads = 8,         // of the attention
                                     .residual = false,  // does not add the rendered logits
                                     .batch = 16,        // images per step
                                     .in_training = {.dropout = 0.1, .turns = true}};  // rotates scenes
    for (const NetworkPreset* preset : {&small, &paper, &pixel})
        if (name == preset->name) return *preset;
    fail<UsageError>("setting refine.network: found \"{}\", expected small, paper or pixel", name);
}

}  // namespace

std::vector<std::string> channel_names(const RayDropNetworkOptions& options) {
    std::vector<std::string> names{"log_range", "intensity", "drop_logit"};
    if (options.network != "paper") names.insert(names.end(), {"weight", "spread", "cosine"});
    if (options.rays != "none") names.emplace_back("elevation");
    if (options.rays == "origin,direction") names.insert(names.end(), {"origin_x", "origin_y", "origin_z"});
    return names;
}

std::size_t count_parameters(const RayDropNetworkOptions& options) {
    return network::UnetLayout(network::make_network(options)).n_parameters;
}

namespace network {

RayDropNetwork make_network(const RayDropNetworkOptions& options) {
    const NetworkPreset& preset = find_preset(options.network);
    // 0 channels or -1 levels select the values of the preset.
    const int width = options.width > 0 ? options.width : int(preset.width);
    const int levels = options.levels >= 0 ? options.levels : int(preset.factors.size()) - 1;
    if (width > kMostWidth || levels > kMostLevels)
        fail<UsageError>(
            "cannot create the ray-drop network: found a width of {} channels and {} levels, expected at "
            "most {} channels and {} levels",
            width, levels, kMostWidth, kMostLevels);
    RayDropNetwork network;
    network.inputs = channel_names(options);
    // Levels beyond the preset have as many channels as its last level.
    for (int level = 0; level <= levels; ++level) {
        const std::size_t preset_level = std::min(std::size_t(level), preset.factors.size() - 1);
        network.widths.push_back(std::uint32_t(width) * preset.factors[preset_level]);
    }
    network.heads = levels > 0 ? preset.heads : 0;
    if (network.heads > 0 && network.widths.back() % network.heads != 0)
        fail<UsageError>(
            "cannot create the ray-drop network: with the width {}, its last level has {} channels, expected "
            "a multiple of {} (the number of attention heads); use a width that is a multiple of {}",
            width, network.widths.back(), network.heads, network.heads);
    network.taps = preset.taps;
    network.residual = preset.residual;
    return network;
}

int batch_size_of(const RayDropNetworkOptions& options) {
    return options.batch > 0 ? options.batch : find_preset(options.network).batch;
}

NetworkRegularisation regularisation_of(const RayDropNetworkOptions& options) {
    return find_preset(options.network).in_training;
}

std::uint32_t find_drop_channel(const RayDropNetwork& network) {
    return std::uint32_t(std::find(network.inputs.begin(), network.inputs.end(), "drop_logit") -
                         network.inputs.begin());
}

std::uint32_t count_fixed_channels(const RayDropNetwork& network) {
    return std::uint32_t(std::count_if(
        network.inputs.begin(), network.inputs.end(),
        [](const std::string& name) { return name == "elevation" || name.starts_with("origin"); }));
}

void check_image(const RayDropNetwork& network, const RayDropImage& image, const std::string& text) {
    const int side = network.min_image_size();
    if (image.rows < side || image.columns < side)
        fail("{}: found {} x {} pixels, expected at least {} x {} pixels for a network with {} levels", text,
             image.rows, image.columns, side, side, network.widths.size() - 1);
    const std::size_t n_columns = std::size_t(image.columns);
    const std::size_t n_pixels = std::size_t(image.rows) * n_columns;
    const std::size_t n_values = n_pixels * network.inputs.size();
    const bool has_drops = !image.dropped.empty();
    if (image.channels.size() != n_values || (has_drops && image.dropped.size() != n_pixels))
        fail("{}: found {} channel values and {} drop values, expected {} and {} for {} x {} pixels", text,
             image.channels.size(), image.dropped.size(), n_values, n_pixels, image.rows, image.columns);
    for (std::size_t i = 0; i < n_values; ++i) {
        if (std::isfinite(image.channels[i])) continue;
        // `channels` has the shape [channels, rows, columns].
        const std::size_t channel = i / n_pixels, pixel = i % n_pixels;
        fail(
            "{}: in the input channel '{}', the value at row {} and column {} is {}, expected a finite "
            "number",
            text, network.inputs[channel], pixel / n_columns, pixel % n_columns, image.channels[i]);
    }
}

/// Creates the loss of batches with up to `n_pixels` pixels. A subgroup (`lanes_`
/// threads) computes two sums over a part of the pixels. The host adds the parts.
RayDropLoss::RayDropLoss(Device& device, std::size_t n_pixels)
    : n_parts_(std::uint32_t(std::max<std::size_t>(1, n_pixels / kPixelsOfPart))),
      lanes_(std::uint32_t(device.info().subgroup_size)),
      kernel_(device, "diff/network/drop_loss", subgroup_constants(lanes_), SubgroupRequirement::full),
      sums_(device, 2 * n_parts_, "sums of cross-entropies") {}  // and of correct predictions

void RayDropLoss::record_loss(Stream& stream, std::size_t n_pixels, const RayDropLossArrays& arrays,
                              std::size_t n_known) {
    relidar::run(stream, kernel_, count_threads(n_parts_, lanes_),
                 {.logit = arrays.logit,
                  .start = arrays.start,
                  .target = arrays.target,
                  .d_logit = arrays.d_logit,
                  .probability = arrays.probability,
                  .partial = sums_.address(),
                  .n = std::uint32_t(n_pixels),
                  .n_parts = n_parts_,
                  // The loss is a mean over the pixels whose drop is known.
                  .weight = 1.0f / float(std::max<std::size_t>(n_known, 1))});
}

RayDropScore RayDropLoss::read_loss(std::size_t n_known_pixels) const {
    double entropy_sum = 0.0, n_correct = 0.0;
    const std::vector<float> sums = sums_.download();  // [parts, 2]
    for (std::size_t part = 0; part < n_parts_; ++part) {
        entropy_sum += double(sums[2 * part]);
        n_correct += double(sums[2 * part + 1]);
    }
    const double n = double(std::max<std::size_t>(n_known_pixels, 1));
    return {.entropy = entropy_sum / n, .accuracy = n_correct / n};
}

}  // namespace network
}  // namespace relidar
