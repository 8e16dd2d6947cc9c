// SPDX-License-Identifier: Apache-2.0
#include "refine/drop_training.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "refine/drop_network.hpp"

namespace relidar::refine {
namespace {

constexpr double kLastRate = 0.01;          // share of the first
constexpr std::uint32_t kKeysOfStep = 64;   // for the layers

void check_images(const DropNetwork& network, const std::vector<DropImage>& images) {
    if (images.empty()) throw DataError("training the ray-drop network: found no images, expected at least one");
    double drops = 0.0;
    for (std::size_t i = 0; i < images.size(); ++i) {
        const DropImage& image = images[i];
        check_image(network, image, fmt::format("training the ray-drop network, image {}", i));
        if (image.rows != images[0].rows || image.columns != images[0].columns)
            throw DataError(fmt::format("training the ray-drop network: image {} has {} x {} pixels, expected {} x {} as the first", i,
                                        image.rows, image.columns, images[0].rows, images[0].columns));
        if (image.dropped.empty())
            throw DataError(fmt::format("training the ray-drop network: nothing was measured for image {}, expected drops", i));
        for (const float dropped : image.dropped) drops += dropped > 0.5f;
    }
    if (drops == 0.0)
        throw DataError(
            "training the ray-drop network: found no dropped ray in any frame, expected some: a log of points alone, whose rays are "
            "not known, has none");
}

DropNetwork start(const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed) {
    DropNetwork network = shape_of(options);
    check_images(network, images);
    network.normalisation = normalisation_of(images, network.inputs.size());
    initialise(network, UnetPlan(network), seed);
    return network;
}

}  // namespace

DropTraining::DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed,
                           bool timing)
    : network_(start(images, options, seed)),
      options_(options),
      n_images_(images.size()),
      batch_(std::min<std::size_t>(std::size_t(options.batch), images.size())),
      grid_{std::uint32_t(batch_), std::uint32_t(images[0].rows), std::uint32_t(images[0].columns)},
      inputs_(device, network_, images),
      unet_(device, network_),
      loss_(device, grid_.all_pixels()),
      adam_(device, network_.parameters.size(), {.epsilon = 1e-8}),
      stream_(device, timing) {
    unet_.reserve(device, grid_, true);
    stream_.fill(unet_.gradients());   // what lies between groups has none
    stream_.finish();
}

DropScore DropTraining::step(std::span<const DropInputs::Chosen> chosen, int step, int n_steps) {
    std::size_t known = 0;
    for (const DropInputs::Chosen& c : chosen) known += inputs_.known(c.sample);
    inputs_.make(stream_, chosen, unet_.inputs());
    unet_.forward(stream_, std::uint32_t(step) * kKeysOfStep, float(options_.dropout));
    loss_.run(stream_, grid_.all_pixels(),
              {.logit = unet_.logit().values.address(),
               .start = network_.residual ? inputs_.start().address() : Address<float>(),
               .target = inputs_.target().address(),
               .d_logit = unet_.d_logit().values.address()},
              known);
    unet_.backward(stream_);
    adam_.step(stream_, unet_.parameters(), unet_.gradients(),
               exponential_schedule(options_.rate, kLastRate * options_.rate, step, n_steps), step);
    stream_.finish();
    return loss_.score(known);
}

DropNetwork DropTraining::download() const {
    DropNetwork result = network_;
    result.parameters = unet_.parameters().download();
    result.running = unet_.running().download();
    return result;
}

}  // namespace relidar::refine
