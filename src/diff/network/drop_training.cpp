// SPDX-License-Identifier: Apache-2.0
#include "diff/network/drop_training.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/optimizer.hpp>

#include "base/fail.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar::network {
namespace {

constexpr double kLastRate = 0.01;         // final learning rate relative to the initial rate
constexpr std::uint32_t kKeysOfStep = 64;  // number of dropout keys per step, one for each layer

/// Checks that all images have the same size and known drops, and that at least one ray
/// was dropped. Otherwise the network could only learn that no ray is dropped.
void check_images(const RayDropNetwork& network, const std::vector<RayDropImage>& images) {
    if (images.empty()) throw DataError("cannot train the ray-drop network: there are no training images");
    double drops = 0.0;
    for (std::size_t i = 0; i < images.size(); ++i) {
        const RayDropImage& image = images[i];
        check_image(network, image, fmt::format("cannot train the ray-drop network with image {}", i));
        if (image.rows != images[0].rows || image.columns != images[0].columns)
            fail(
                "cannot train the ray-drop network: image {} has {} x {} pixels, expected {} x {} like the "
                "first image",
                i, image.rows, image.columns, images[0].rows, images[0].columns);
        if (image.dropped.empty())
            fail(
                "cannot train the ray-drop network: image {} does not say which measured rays had no return, "
                "expected one such value per pixel",
                i);
        for (const float dropped : image.dropped) drops += dropped > 0.5f;
    }
    if (drops == 0.0)
        throw DataError(
            "cannot train the ray-drop network: no training frame has a dropped ray, because the log "
            "probably contains only points and no rays without return; use --set refine.enabled=false");
}

RayDropNetwork initial_network(const std::vector<RayDropImage>& all, const RayDropNetworkOptions& o,
                               std::uint64_t seed) {
    RayDropNetwork network = make_network(o);
    check_images(network, all);
    network.normalisation = channel_scaling(all, network.inputs.size());
    init_parameters(network, UnetLayout(network), seed);
    return network;
}

}  // namespace

struct RayDropTraining::Impl {
    const RayDropNetwork network;  ///< shape, normalisation and initial parameters
    const RayDropNetworkOptions options;
    const std::size_t n_images, batch;
    const ImageBatchSize grid;
    RayDropInputs inputs;
    Unet unet;
    RayDropLoss loss;
    ArrayAdam adam;
    Stream stream;

    Impl(Device& device, const std::vector<RayDropImage>& images, const RayDropNetworkOptions& o,
         std::uint64_t seed, bool timing)
        : network(initial_network(images, o, seed)),
          options(o),
          n_images(images.size()),
          batch(std::min<std::size_t>(std::size_t(batch_size_of(o)), images.size())),
          grid{std::uint32_t(batch), std::uint32_t(images[0].rows), std::uint32_t(images[0].columns),
               images[0].circular},
          inputs(device, network),
          unet(device, network),
          loss(device, grid.n_pixels_total()),
          adam(device, network.parameters.size(), {.epsilon = 1e-8}),
          stream(device, timing) {
        inputs.upload_images(device, images);
        unet.allocate(device, grid, true);
        // Sets the gradients to zero, because no kernel writes the padding between groups
        // of parameters.
        stream.fill(unet.gradients());
        stream.submit_and_wait();
    }
};

RayDropTraining::RayDropTraining(Device& device, const std::vector<RayDropImage>& images,
                                 const RayDropNetworkOptions& options, std::uint64_t seed, bool timing)
    : impl_(std::make_unique<Impl>(device, images, options, seed, timing)) {}
RayDropTraining::~RayDropTraining() = default;

std::size_t RayDropTraining::images_per_step() const { return impl_->batch; }
std::size_t RayDropTraining::steps_per_epoch() const { return impl_->n_images / impl_->batch; }
const KernelTimes& RayDropTraining::times() const { return impl_->stream.times(); }

/// Runs one training step on a batch: forward pass, loss, backward pass and Adam step.
/// The learning rate falls exponentially to kLastRate of its initial value.
/// @return loss and accuracy before the step
RayDropScore RayDropTraining::train_on_batch(std::span<const RotatedSample> samples, int step, int n_steps) {
    Impl& t = *impl_;
    std::size_t n_known_pixels = 0;
    for (const RotatedSample& c : samples) n_known_pixels += t.inputs.count_known(c.sample);
    t.inputs.fill_batch(t.stream, samples, t.unet.input_images());
    t.unet.forward(t.stream, std::uint32_t(step) * kKeysOfStep, float(regularisation_of(t.options).dropout));
    t.loss.record_loss(t.stream, t.grid.n_pixels_total(),
                       {.logit = t.unet.logits().values.address().cast_tag<shared::DropLogits>(),
                        .start = t.network.residual ? t.inputs.rendered_logits().address()
                                                    : Address<float, shared::StartLogits>(),
                        .target = t.inputs.measured_drops().address(),
                        .d_logit = t.unet.d_logits().values.address().cast_tag<shared::DropLogitGradients>()},
                       n_known_pixels);
    t.unet.backward(t.stream);
    t.adam.record_step(t.stream, t.unet.parameters(), t.unet.gradients(),
                       interpolate_exp(t.options.rate, kLastRate * t.options.rate, step, n_steps), step);
    t.stream.submit_and_wait();
    return t.loss.read_loss(n_known_pixels);
}

RayDropNetwork RayDropTraining::download_network() const {
    RayDropNetwork result = impl_->network;
    result.parameters = impl_->unet.parameters().download();
    result.running = impl_->unet.running_moments().download();
    return result;
}

RayDropTrainState RayDropTraining::download_state() const {
    RayDropTrainState state;
    state.parameters = impl_->unet.parameters().download();
    state.moment1 = impl_->adam.first_moments().download();
    state.moment2 = impl_->adam.second_moments().download();
    state.running = impl_->unet.running_moments().download();
    return state;
}

void RayDropTraining::restore_state(const RayDropTrainState& state) {
    const auto check = [](const char* name, std::size_t found, std::size_t expected) {
        if (found != expected)
            fail("cannot resume the ray-drop network: {}: found {} numbers, expected {}", name, found,
                 expected);
    };
    const RayDropNetwork& n = impl_->network;
    check("parameters", state.parameters.size(), n.parameters.size());
    check("moment1", state.moment1.size(), n.parameters.size());
    check("moment2", state.moment2.size(), n.parameters.size());
    check("running", state.running.size(), n.running.size());
    impl_->unet.set_parameters(state.parameters, state.running);
    impl_->adam.first_moments().upload(state.moment1);
    impl_->adam.second_moments().upload(state.moment2);
}

}  // namespace relidar::network
