// SPDX-License-Identifier: Apache-2.0
#include "diff/network/drop_training.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/optimizer.hpp>

#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar::refine {
namespace {

constexpr double kLastRate = 0.01;         // final learning rate relative to the initial rate
constexpr std::uint32_t kKeysOfStep = 64;  // number of dropout keys per step, one for each layer

void check_images(const DropNetwork& network, const std::vector<DropImage>& images) {
    if (images.empty()) throw DataError("cannot train the ray-drop network: there are no training images");
    double drops = 0.0;
    for (std::size_t i = 0; i < images.size(); ++i) {
        const DropImage& image = images[i];
        check_image(network, image, fmt::format("cannot train the ray-drop network with image {}", i));
        if (image.rows != images[0].rows || image.columns != images[0].columns)
            throw DataError(fmt::format(
                "cannot train the ray-drop network: image {} has {} x {} pixels, expected {} x {} like "
                "the first image",
                i, image.rows, image.columns, images[0].rows, images[0].columns));
        if (image.dropped.empty())
            throw DataError(
                fmt::format("cannot train the ray-drop network: image {} has no measured drops", i));
        for (const float dropped : image.dropped) drops += dropped > 0.5f;
    }
    if (drops == 0.0)
        throw DataError(
            "cannot train the ray-drop network: no training frame has a dropped ray, because the log "
            "probably contains only points and no rays without return; use --set refine.enabled=false");
}

DropNetwork make_initial_network(const std::vector<DropImage>& images, const RefineOptions& options,
                                 std::uint64_t seed) {
    DropNetwork network = make_network_shape(options);
    check_images(network, images);
    network.normalisation = compute_normalisation(images, network.inputs.size());
    initialise(network, UnetPlan(network), seed);
    return network;
}

}  // namespace

struct DropTraining::Impl {
    const DropNetwork network;  ///< shape, normalisation and initial parameters
    const RefineOptions options;
    const std::size_t n_images, batch;
    const Grid grid;
    DropInputs inputs;
    Unet unet;
    DropLoss loss;
    ArrayAdam adam;
    Stream stream;

    Impl(Device& device, const std::vector<DropImage>& images, const RefineOptions& o, std::uint64_t seed,
         bool timing)
        : network(make_initial_network(images, o, seed)),
          options(o),
          n_images(images.size()),
          batch(std::min<std::size_t>(std::size_t(get_batch_size(o)), images.size())),
          grid{std::uint32_t(batch), std::uint32_t(images[0].rows), std::uint32_t(images[0].columns)},
          inputs(device, network),
          unet(device, network),
          loss(device, grid.all_pixels()),
          adam(device, network.parameters.size(), {.epsilon = 1e-8}),
          stream(device, timing) {
        inputs.keep(device, images);
        unet.reserve(device, grid, true);
        // the padding between groups of parameters needs gradients of zero, and no kernel
        // writes it
        stream.fill(unet.gradients());
        stream.finish();
    }
};

DropTraining::DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options,
                           std::uint64_t seed, bool timing)
    : impl_(std::make_unique<Impl>(device, images, options, seed, timing)) {}
DropTraining::~DropTraining() = default;

std::size_t DropTraining::batch() const { return impl_->batch; }
std::size_t DropTraining::count_steps_per_epoch() const { return impl_->n_images / impl_->batch; }
const KernelTimes& DropTraining::times() const { return impl_->stream.times(); }

DropScore DropTraining::step(std::span<const DropInputs::Chosen> chosen, int step, int n_steps) {
    Impl& t = *impl_;
    std::size_t known = 0;
    for (const DropInputs::Chosen& c : chosen) known += t.inputs.known(c.sample);
    t.inputs.make(t.stream, chosen, t.unet.inputs());
    t.unet.forward(t.stream, std::uint32_t(step) * kKeysOfStep,
                   float(make_regularisation(t.options).dropout));
    t.loss.run(
        t.stream, t.grid.all_pixels(),
        {.logit = t.unet.logit().values.address().as<shared::DropLogits>(),
         .start = t.network.residual ? t.inputs.start().address() : Address<float, shared::StartLogits>(),
         .target = t.inputs.target().address(),
         .d_logit = t.unet.d_logit().values.address().as<shared::DropLogitGradients>()},
        known);
    t.unet.backward(t.stream);
    t.adam.step(t.stream, t.unet.parameters(), t.unet.gradients(),
                interpolate_exponentially(t.options.rate, kLastRate * t.options.rate, step, n_steps), step);
    t.stream.finish();
    return t.loss.score(known);
}

DropNetwork DropTraining::download() const {
    DropNetwork result = impl_->network;
    result.parameters = impl_->unet.parameters().download();
    result.running = impl_->unet.running().download();
    return result;
}

RefineState DropTraining::state() const {
    RefineState state;
    state.parameters = impl_->unet.parameters().download();
    state.moment1 = impl_->adam.moment1().download();
    state.moment2 = impl_->adam.moment2().download();
    state.running = impl_->unet.running().download();
    return state;
}

void DropTraining::restore(const RefineState& state) {
    const auto check = [](const char* name, std::size_t found, std::size_t expected) {
        if (found != expected)
            throw DataError(
                fmt::format("cannot resume the ray-drop network: {}: found {} numbers, expected {}", name,
                            found, expected));
    };
    const DropNetwork& n = impl_->network;
    check("parameters", state.parameters.size(), n.parameters.size());
    check("moment1", state.moment1.size(), n.parameters.size());
    check("moment2", state.moment2.size(), n.parameters.size());
    check("running", state.running.size(), n.running.size());
    impl_->unet.upload(state.parameters, state.running);
    impl_->adam.moment1().upload(state.moment1);
    impl_->adam.moment2().upload(state.moment2);
}

}  // namespace relidar::refine
