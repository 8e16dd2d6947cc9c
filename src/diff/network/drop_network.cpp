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

/// Predefined network architecture. The numbers of channels are listed for each level,
/// starting at full image size, and are multiplied by `width`.
struct NetworkPreset {
    const char* name;
    std::uint32_t width;
    std::vector<std::uint32_t> factors;
    std::uint32_t heads, taps;
    bool residual;
    int batch;
    NetworkRegularisation in_training;
};

const NetworkPreset& find_predefined(const std::string& name) {
    // name, width, factors, heads, taps, residual, batch, {dropout, turns}
    static const NetworkPreset networks[] = {{"small", 8, {1, 2, 4, 4}, 0, 9, true, 1, {}},
                                             {"paper", 32, {1, 2, 4, 8, 8}, 8, 9, false, 16, {0.1, true}},
                                             {"pixel", 16, {1}, 0, 1, true, 1, {}}};
    const auto match = std::find_if(std::begin(networks), std::end(networks),
                                    [&](const NetworkPreset& preset) { return name == preset.name; });
    if (match == std::end(networks))
        fail<UsageError>("setting refine.network: found \"{}\", expected small, paper or pixel", name);
    return *match;
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
    const NetworkPreset& preset = find_predefined(options.network);
    const int width = options.width > 0 ? options.width : int(preset.width);
    const int levels = options.levels >= 0 ? options.levels : int(preset.factors.size()) - 1;
    if (width > kMostWidth || levels > kMostLevels)
        fail<UsageError>(
            "cannot create the ray-drop network: found a width of {} channels and {} levels, expected at "
            "most {} channels and {} levels",
            width, levels, kMostWidth, kMostLevels);
    RayDropNetwork network;
    network.inputs = channel_names(options);
    for (int l = 0; l <= levels; ++l)
        network.widths.push_back(std::uint32_t(width) *
                                 preset.factors[std::min(std::size_t(l), preset.factors.size() - 1)]);
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
    return options.batch > 0 ? options.batch : find_predefined(options.network).batch;
}

NetworkRegularisation regularisation_of(const RayDropNetworkOptions& options) {
    return find_predefined(options.network).in_training;
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
    const std::size_t pixels = std::size_t(image.rows) * std::size_t(image.columns),
                      n = pixels * network.inputs.size();
    if (image.channels.size() != n || (!image.dropped.empty() && image.dropped.size() != pixels))
        fail("{}: found {} channel values and {} drop values, expected {} and {} for {} x {} pixels", text,
             image.channels.size(), image.dropped.size(), n, pixels, image.rows, image.columns);
    const auto bad = std::find_if(image.channels.begin(), image.channels.end(),
                                  [](float value) { return !std::isfinite(value); });
    if (bad != image.channels.end()) {
        const auto at = std::size_t(bad - image.channels.begin());
        fail(
            "{}: in the input channel '{}', the value at row {} and column {} is {}, expected a finite "
            "number",
            text, network.inputs[at / pixels], at % pixels / std::size_t(image.columns),
            at % std::size_t(image.columns), *bad);
    }
}

RayDropLoss::RayDropLoss(Device& device, std::size_t n_pixels)
    : n_parts_(std::uint32_t(std::max<std::size_t>(1, n_pixels / kPixelsOfPart))),
      lanes_(std::uint32_t(device.info().subgroup_size)),
      kernel_(
          device, "diff/network/drop_loss",
          {{SpecialisationConstantId::LANES, lanes_}, {SpecialisationConstantId::WORKGROUP_SIZE, kThreads}},
          SubgroupRequirement::full),
      partial_(device, 2 * n_parts_, "sums of cross-entropies") {}

void RayDropLoss::record_loss(Stream& s, std::size_t n, const RayDropLossArrays& a, std::size_t n_known) {
    // One subgroup processes one part.
    const std::uint32_t of_workgroup = kThreads / lanes_;
    relidar::run(s, kernel_, std::size_t((n_parts_ + of_workgroup - 1) / of_workgroup) * kThreads,
                 {.logit = a.logit,
                  .start = a.start,
                  .target = a.target,
                  .d_logit = a.d_logit,
                  .probability = a.probability,
                  .partial = partial_.address(),
                  .n = std::uint32_t(n),
                  .n_parts = n_parts_,
                  .weight = 1.0f / float(std::max<std::size_t>(n_known, 1))});
}

RayDropScore RayDropLoss::read_loss(std::size_t n_known_pixels) const {
    RayDropScore score;
    const std::vector<float> partial = partial_.download();
    // Each part has two sums: cross-entropies, and number of correct predictions.
    for (std::size_t part = 0; part < n_parts_; ++part) {
        score.entropy += double(partial[2 * part]);
        score.accuracy += double(partial[2 * part + 1]);
    }
    score.entropy /= double(std::max<std::size_t>(n_known_pixels, 1));
    score.accuracy /= double(std::max<std::size_t>(n_known_pixels, 1));
    return score;
}

}  // namespace network
}  // namespace relidar
