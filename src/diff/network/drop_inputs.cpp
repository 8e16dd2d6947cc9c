// SPDX-License-Identifier: Apache-2.0
// Submits the kernel diff/network/drop_inputs, which copies stored samples into input
// images.
#include "diff/network/drop_inputs.hpp"

#include <algorithm>
#include <cmath>

#include "diff/network/drop_network.hpp"

namespace relidar::refine {
namespace {

template <class Joined, class Values>
Joined joined(Device& device, std::span<const DropImage> images, const Values& values,
              const std::string& description) {
    std::size_t n = 0;
    for (const DropImage& image : images) n += values(image).size();
    Joined all(device, n, description);
    std::size_t first = 0;
    for (const DropImage& image : images) {
        all.upload(std::span<const float>(values(image)), first);
        first += values(image).size();
    }
    return all;
}

Array<glm::vec2> make_pairs(Device& device, const std::vector<float>& values) {
    std::vector<glm::vec2> result;
    for (std::size_t i = 0; i + 1 < values.size(); i += 2) result.emplace_back(values[i], values[i + 1]);
    return Array<glm::vec2>(device, std::span<const glm::vec2>(result), "normalisation of inputs");
}

}  // namespace

std::vector<float> compute_normalisation(const std::vector<DropImage>& images, std::size_t n_channels) {
    std::vector<float> scale_shift;
    for (std::size_t c = 0; c < n_channels; ++c) {
        double n = 0.0, sum = 0.0, squares = 0.0;
        const auto for_each = [&](const auto& work) {
            for (const DropImage& image : images) {
                const std::size_t pixels = image.channels.size() / n_channels;
                for (std::size_t i = c * pixels; i < (c + 1) * pixels; ++i) work(double(image.channels[i]));
            }
        };
        for_each([&](double value) { n += 1.0, sum += value; });
        const double mean = sum / n;
        for_each([&](double value) { squares += (value - mean) * (value - mean); });
        const double deviation = std::sqrt(squares / n), scale = deviation > 1e-6 ? 1.0 / deviation : 0.0;
        scale_shift.push_back(float(scale));
        scale_shift.push_back(float(-mean * scale));
    }
    return scale_shift;
}

DropInputs::DropInputs(Device& device, const DropNetwork& network)
    : n_channels_(std::uint32_t(network.inputs.size())),
      n_fixed_(count_fixed_channels(network)),
      logit_channel_(get_logit_channel(network)),
      kernel_(device, "diff/network/drop_inputs"),
      scale_shift_(make_pairs(device, network.normalisation)) {}

void DropInputs::keep(Device& device, std::span<const DropImage> images) {
    samples_ = joined<decltype(samples_)>(
        device, images, [](const DropImage& image) -> const std::vector<float>& { return image.channels; },
        "scans to refine");
    targets_ = joined<decltype(targets_)>(
        device, images, [](const DropImage& image) -> const std::vector<float>& { return image.dropped; },
        "measured drops");
    known_.clear();
    for (const DropImage& image : images)
        known_.push_back(std::size_t(std::count_if(image.dropped.begin(), image.dropped.end(),
                                                   [](float value) { return value >= 0.0f; })));
}

void DropInputs::make(Stream& stream, std::span<const Chosen> chosen, const Tensor& images) {
    shared::DropInputsParams params{};
    params.samples = samples_.address();
    if (has_targets()) {
        target_.reserve(stream.device(), images.grid.all_pixels(), "targets");
        params.targets = targets_.address(), params.target = target_.address();
    }
    make(stream, chosen, params, images);
}

void DropInputs::make(Stream& stream, std::span<const Chosen> chosen,
                      Address<float, shared::DropSamples> samples, const Tensor& images) {
    shared::DropInputsParams params{};
    params.samples = samples;
    make(stream, chosen, params, images);
}

/// Submits the kernel that copies the chosen images into a batch.
/// @param params must contain the addresses of samples and targets
void DropInputs::make(Stream& stream, std::span<const Chosen> chosen, shared::DropInputsParams params,
                      const Tensor& images) {
    std::vector<std::uint32_t> samples, turns;
    for (const Chosen& c : chosen) {
        samples.push_back(c.sample);
        turns.push_back(c.turn);
    }
    start_.reserve(stream.device(), images.grid.all_pixels(), "rendered logits");
    params.chosen = stream.impl().values(samples).as<shared::ChosenSamples>();
    params.turn = stream.impl().values(turns).as<shared::SampleTurns>();
    params.scale_shift = scale_shift_.address();
    params.images = images.values.address();
    params.start = start_.address();
    params.n_images = images.grid.n;
    params.n_channels = n_channels_, params.n_fixed = n_fixed_, params.logit_channel = logit_channel_;
    params.rows = images.grid.rows, params.columns = images.grid.columns;
    run(stream, kernel_, images.grid.all_pixels(), params);
}

}  // namespace relidar::refine
