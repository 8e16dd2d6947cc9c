// SPDX-License-Identifier: Apache-2.0
#include "diff/network/drop_network.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::network {
namespace {

template <class Joined, class Values>
Joined upload_joined_values(Device& device, std::span<const RayDropImage> images, const Values& get_values,
                            const std::string& text) {
    std::size_t n = 0;
    for (const RayDropImage& image : images) n += get_values(image).size();
    Joined all(device, n, text);
    std::size_t first = 0;
    for (const RayDropImage& image : images) {
        all.upload(get_values(image), first);
        first += get_values(image).size();
    }
    return all;
}

}  // namespace

std::vector<float> channel_scaling(const std::vector<RayDropImage>& images, std::size_t n_channels) {
    std::vector<float> scale_shift;
    for (std::size_t c = 0; c < n_channels; ++c) {
        double n = 0.0, sum = 0.0, squares = 0.0;
        const auto for_each = [&](const auto& work) {
            for (const RayDropImage& image : images) {
                const std::size_t pixels = image.channels.size() / n_channels;
                for (std::size_t i = c * pixels; i < (c + 1) * pixels; ++i) work(double(image.channels[i]));
            }
        };
        for_each([&](double value) {
            n += 1.0;
            sum += value;
        });
        const double mean = sum / n;
        for_each([&](double value) { squares += (value - mean) * (value - mean); });
        const double deviation = std::sqrt(squares / n), scale = deviation > 1e-6 ? 1.0 / deviation : 0.0;
        scale_shift.push_back(float(scale));
        scale_shift.push_back(float(-mean * scale));
    }
    return scale_shift;
}

RayDropInputs::RayDropInputs(Device& device, const RayDropNetwork& network)
    : n_channels_(std::uint32_t(network.inputs.size())),
      n_fixed_(count_fixed_channels(network)),
      logit_channel_(find_drop_channel(network)),
      kernel_(device, "diff/network/drop_inputs") {
    std::vector<glm::vec2> scale_shift_pairs;
    for (std::size_t i = 0; i + 1 < network.normalisation.size(); i += 2)
        scale_shift_pairs.emplace_back(network.normalisation[i], network.normalisation[i + 1]);
    scale_shift_ = Array<glm::vec2>(device, scale_shift_pairs, "normalisation of inputs");
}

void RayDropInputs::upload_images(Device& device, std::span<const RayDropImage> images) {
    samples_ = upload_joined_values<decltype(samples_)>(
        device, images, [](const RayDropImage& image) -> const std::vector<float>& { return image.channels; },
        "scans to refine");
    targets_ = upload_joined_values<decltype(targets_)>(
        device, images, [](const RayDropImage& image) -> const std::vector<float>& { return image.dropped; },
        "measured drops");
    n_known_pixels_.clear();
    // A negative target is unknown.
    for (const RayDropImage& image : images)
        n_known_pixels_.push_back(std::size_t(std::count_if(image.dropped.begin(), image.dropped.end(),
                                                            [](float value) { return value >= 0.0f; })));
}

void RayDropInputs::fill_batch(Stream& stream, std::span<const RotatedSample> chosen, const Tensor& to) {
    shared::DropInputsParams params{};
    params.samples = samples_.address();
    if (has_measured()) {
        target_.reserve(stream.device(), to.grid.n_pixels_total(), "targets");
        params.targets = targets_.address();
        params.target = target_.address();
    }
    fill_batch(stream, chosen, params, to);
}

void RayDropInputs::fill_batch(Stream& stream, std::span<const RotatedSample> chosen,
                               Address<float, shared::DropSamples> samples, const Tensor& to) {
    shared::DropInputsParams params{};
    params.samples = samples;
    fill_batch(stream, chosen, params, to);
}

void RayDropInputs::fill_batch(Stream& stream, std::span<const RotatedSample> chosen,
                               shared::DropInputsParams params, const Tensor& to) {
    std::vector<std::uint32_t> samples, column_shifts;
    for (const RotatedSample& c : chosen) {
        samples.push_back(c.sample);
        column_shifts.push_back(c.column_shift);
    }
    start_.reserve(stream.device(), to.grid.n_pixels_total(), "rendered logits");
    params.chosen = stream.impl().stage_values(samples).cast_tag<shared::ChosenSamples>();
    params.turn = stream.impl().stage_values(column_shifts).cast_tag<shared::SampleTurns>();
    params.scale_shift = scale_shift_.address();
    params.images = to.values.address();
    params.start = start_.address();
    params.n_images = to.grid.n;
    params.n_channels = n_channels_;
    params.n_fixed = n_fixed_;
    params.logit_channel = logit_channel_;
    params.rows = to.grid.rows;
    params.columns = to.grid.columns;
    run(stream, kernel_, to.grid.n_pixels_total(), params);
}

}  // namespace relidar::network
