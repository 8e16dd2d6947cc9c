// SPDX-License-Identifier: Apache-2.0
#include "diff/network/drop_network.hpp"

#include <algorithm>
#include <cmath>

namespace relidar::network {
namespace {

/// Uploads one array of values of all images, one image after the other.
/// @param values array of an image: `channels` or `dropped`
template <class DeviceArray>
DeviceArray upload_all(Device& device, std::span<const RayDropImage> images,
                       std::vector<float> RayDropImage::*values, const std::string& text) {
    std::size_t n_values = 0;
    for (const RayDropImage& image : images) n_values += (image.*values).size();
    DeviceArray all(device, n_values, text);
    std::size_t first = 0;
    for (const RayDropImage& image : images) {
        all.upload(image.*values, first);
        first += (image.*values).size();
    }
    return all;
}

/// Returns the values of one channel in an image [channels, rows, columns].
std::span<const float> channel_of(const RayDropImage& image, std::size_t channel, std::size_t n_channels) {
    const std::size_t n_pixels = image.channels.size() / n_channels;
    return std::span(image.channels).subspan(channel * n_pixels, n_pixels);
}

}  // namespace

std::vector<float> channel_scaling(const std::vector<RayDropImage>& images, std::size_t n_channels) {
    std::vector<float> scale_shift;
    for (std::size_t channel = 0; channel < n_channels; ++channel) {
        std::size_t n = 0;
        double sum = 0.0;
        for (const RayDropImage& image : images) {
            for (const float value : channel_of(image, channel, n_channels)) sum += double(value);
            n += image.channels.size() / n_channels;
        }
        const double mean = sum / double(n);

        double squares = 0.0;
        for (const RayDropImage& image : images)
            for (const float value : channel_of(image, channel, n_channels))
                squares += (double(value) - mean) * (double(value) - mean);
        const double deviation = std::sqrt(squares / double(n));

        const double scale = deviation > 1e-6 ? 1.0 / deviation : 0.0;
        scale_shift.push_back(float(scale));
        scale_shift.push_back(float(-mean * scale));
    }
    return scale_shift;
}

/// Copies the normalisation of the network to the device: scale and shift of each input
/// channel. The last channels describe the sensor, so they do not rotate with the scene.
RayDropInputs::RayDropInputs(Device& device, const RayDropNetwork& network)
    : n_channels_(std::uint32_t(network.inputs.size())),
      n_sensor_channels_(count_fixed_channels(network)),
      logit_channel_(find_drop_channel(network)),
      kernel_(device, "diff/network/drop_inputs") {
    const std::vector<float>& values = network.normalisation;  // [channels, 2]
    std::vector<glm::vec2> scale_shift;
    for (std::size_t channel = 0; channel < values.size() / 2; ++channel)
        scale_shift.emplace_back(values[2 * channel], values[2 * channel + 1]);
    scale_shift_ = Array<glm::vec2>(device, scale_shift, "normalisation of inputs");
}

void RayDropInputs::upload_images(Device& device, std::span<const RayDropImage> images) {
    samples_ = upload_all<decltype(samples_)>(device, images, &RayDropImage::channels, "scans to refine");
    all_drops_ = upload_all<decltype(all_drops_)>(device, images, &RayDropImage::dropped, "measured drops");

    const auto is_known = [](float dropped) { return dropped >= 0.0f; };
    n_known_pixels_.clear();
    for (const RayDropImage& image : images)
        n_known_pixels_.push_back(std::size_t(std::ranges::count_if(image.dropped, is_known)));
}

void RayDropInputs::fill_batch(Stream& stream, std::span<const RotatedSample> chosen, const Tensor& to,
                               Address<float, shared::DropSamples> samples) {
    std::vector<std::uint32_t> indices, column_shifts;
    for (const RotatedSample& image : chosen) {
        indices.push_back(image.sample);
        column_shifts.push_back(image.column_shift);
    }
    const std::size_t n_pixels = to.grid.n_pixels_total();
    const bool uses_uploaded = samples == Address<float, shared::DropSamples>();
    rendered_logits_.reserve(stream.device(), n_pixels, "rendered logits");
    shared::DropInputsParams params{};
    params.samples = uses_uploaded ? samples_.address() : samples;
    if (uses_uploaded) {
        // Also copies which rays were dropped in the log, the target of the training.
        batch_drops_.reserve(stream.device(), n_pixels, "targets");
        params.targets = all_drops_.address();
        params.target = batch_drops_.address();
    }
    params.chosen = stream.impl().stage_values(indices).cast_tag<shared::ChosenSamples>();
    params.turn = stream.impl().stage_values(column_shifts).cast_tag<shared::SampleTurns>();
    params.scale_shift = scale_shift_.address();
    params.images = to.values.address();
    params.start = rendered_logits_.address();  // receives the channel `logit_channel`
    params.n_images = to.grid.n;
    params.n_channels = n_channels_;
    params.n_fixed = n_sensor_channels_;  // the last channels, which do not rotate
    params.logit_channel = logit_channel_;
    params.rows = to.grid.rows;
    params.columns = to.grid.columns;
    run(stream, kernel_, n_pixels, params);
}

}  // namespace relidar::network
