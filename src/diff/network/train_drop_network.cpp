// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network with the cross-entropy loss (Eq. 13) and the Adam
// optimizer. Each epoch shuffles the images and rotates them by a random number of
// columns.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <random>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/optimizer.hpp>

#include "base/fail.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace network {
namespace {

constexpr double kLastRate = 0.01;         // final learning rate relative to the initial rate
constexpr std::uint32_t kKeysOfStep = 64;  // number of dropout keys per step, one for each layer

/// Checks that all images have the same size and known drops, and that at least one ray
/// was dropped. Otherwise the network could only learn that no ray is dropped, as in a
/// closed room.
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
            "the run has no ray-drop network, because no ray of the training frames is dropped; nothing is "
            "missing, unless the log contains only points and leaves out rays without return");
}

/// Returns a network with random weights and the normalisation of the training images.
RayDropNetwork initial_network(const std::vector<RayDropImage>& all, const RayDropNetworkOptions& o,
                               std::uint64_t seed) {
    RayDropNetwork network = make_network(o);
    check_images(network, all);
    network.normalisation = channel_scaling(all, network.inputs.size());
    init_parameters(network, UnetLayout(network), seed);
    return network;
}

/// Draws the order of the images and their rotations for one epoch. The seed depends on
/// the epoch, so that a resumed training draws the same values.
std::vector<RotatedSample> sample_epoch(std::size_t n, int n_columns, bool rotate, std::uint64_t seed,
                                        int epoch) {
    std::mt19937_64 random(seed * 1000003u + std::uint64_t(epoch));
    std::vector<RotatedSample> chosen(n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t j = random() % (i + 1);  // inside-out variant of the Fisher-Yates shuffle
        chosen[i].sample = chosen[j].sample;
        chosen[j].sample = std::uint32_t(i);
    }
    if (rotate)
        for (RotatedSample& sample : chosen)
            sample.column_shift = std::uint32_t(random() % std::uint64_t(n_columns));
    return chosen;
}

class RayDropTraining {
public:
    RayDropTraining(Device& device, const std::vector<RayDropImage>& images, const RayDropNetworkOptions& o,
                    std::uint64_t seed, const RayDropTrainState* start)
        : network_(initial_network(images, o, seed)),
          options_(o),
          seed_(seed),
          n_images_(images.size()),
          batch_(std::min<std::size_t>(std::size_t(batch_size_of(o)), n_images_)),
          n_steps_(n_images_ / batch_),
          grid_{std::uint32_t(batch_), std::uint32_t(images[0].rows), std::uint32_t(images[0].columns),
                images[0].circular},
          inputs_(device, network_),
          unet_(device, network_),
          loss_(device, grid_.n_pixels_total()),
          adam_(device, network_.parameters.size(), {.epsilon = 1e-8}),
          stream_(device) {
        report.n_epochs = o.epochs;
        report.n_steps = o.epochs * int(n_steps_);
        inputs_.upload_images(device, images);
        unet_.allocate(device, grid_, true);
        // Sets the gradients to zero, because no kernel writes the padding between groups
        // of parameters.
        stream_.fill(unet_.gradients());
        stream_.submit_and_wait();
        if (start) restore_state(*start);
    }

    RayDropTrainProgress report;

    /// Trains on the next batch. An epoch leaves out images that do not fill a complete
    /// batch. The order is random, so each epoch leaves out other images.
    void train_on_next_batch() {
        const std::size_t step_in_epoch = std::size_t(report.step++) % n_steps_;
        const int epoch = int(std::size_t(report.step - 1) / n_steps_);
        if (step_in_epoch == 0) entropy_ = accuracy_ = 0.0;
        // `order_` is also empty after a resume within an epoch.
        if (step_in_epoch == 0 || order_.empty())
            order_ = sample_epoch(n_images_, int(grid_.columns),
                                  regularisation_of(options_).turns && grid_.circular, seed_, epoch);
        const RayDropScore score = train_on_batch(std::span(order_).subspan(step_in_epoch * batch_, batch_));
        entropy_ += score.entropy;
        accuracy_ += score.accuracy;
        report.epoch = epoch + 1;
        report.entropy = entropy_ / double(step_in_epoch + 1);
        report.accuracy = accuracy_ / double(step_in_epoch + 1);
        report.seconds =
            before_s_ + std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
        if (!std::isfinite(score.entropy))
            fail(
                "training the ray-drop network failed: the loss is {} in step {}, expected a finite number; "
                "use a smaller value of the setting refine.rate",
                score.entropy, report.step);
    }

    RayDropNetwork download_network() const {
        RayDropNetwork result = network_;
        result.parameters = unet_.parameters().download();
        result.running = unet_.running_moments().download();
        return result;
    }

    RayDropTrainState download_state() {
        return {.step = report.step,
                .parameters = unet_.parameters().download(),
                .moment1 = adam_.first_moments().download(),
                .moment2 = adam_.second_moments().download(),
                .running = unet_.running_moments().download(),
                .entropy = entropy_,
                .accuracy = accuracy_,
                .seconds = report.seconds};
    }

private:
    const RayDropNetwork network_;  ///< shape, normalisation and initial parameters
    const RayDropNetworkOptions options_;
    const std::uint64_t seed_;
    const std::size_t n_images_, batch_, n_steps_;  ///< images per step, steps per epoch
    const ImageBatchSize grid_;
    RayDropInputs inputs_;
    Unet unet_;
    RayDropLoss loss_;
    ArrayAdam adam_;
    Stream stream_;
    std::vector<RotatedSample> order_;       ///< images of the current epoch
    double entropy_ = 0.0, accuracy_ = 0.0;  ///< sums over the steps of the epoch
    double before_s_ = 0.0;                  ///< duration of earlier sessions of this training, s
    const std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();

    /// Runs forward pass, loss, backward pass and Adam step. The learning rate falls
    /// exponentially to kLastRate of its initial value.
    /// @return loss and accuracy before the step
    RayDropScore train_on_batch(std::span<const RotatedSample> samples) {
        std::size_t n_known_pixels = 0;
        for (const RotatedSample& c : samples) n_known_pixels += inputs_.count_known(c.sample);
        inputs_.fill_batch(stream_, samples, unet_.input_images());
        unet_.forward(stream_, std::uint32_t(report.step) * kKeysOfStep,
                      float(regularisation_of(options_).dropout));
        loss_.record_loss(
            stream_, grid_.n_pixels_total(),
            {.logit = unet_.logits().values.address().cast_tag<shared::DropLogits>(),
             .start = address_or_null(network_.residual ? &inputs_.rendered_logits() : nullptr),
             .target = inputs_.measured_drops().address(),
             .d_logit = unet_.d_logits().values.address().cast_tag<shared::DropLogitGradients>()},
            n_known_pixels);
        unet_.backward(stream_);
        adam_.record_step(
            stream_, unet_.parameters(), unet_.gradients(),
            interpolate_exp(options_.rate, kLastRate * options_.rate, report.step, report.n_steps),
            report.step);
        stream_.submit_and_wait();
        return loss_.read_loss(n_known_pixels);
    }

    void restore_state(const RayDropTrainState& state) {
        if (state.step < 0 || state.step > report.n_steps)
            fail(
                "cannot resume the training of the ray-drop network: the saved training is at step {}, "
                "expected 0 to {}, the last step with {} epochs (refine.epochs)",
                state.step, report.n_steps, report.n_epochs);
        const auto check = [](const char* name, std::size_t found, std::size_t expected) {
            if (found != expected)
                fail("cannot resume the ray-drop network: {}: found {} numbers, expected {}", name, found,
                     expected);
        };
        check("parameters", state.parameters.size(), network_.parameters.size());
        check("moment1", state.moment1.size(), network_.parameters.size());
        check("moment2", state.moment2.size(), network_.parameters.size());
        check("running", state.running.size(), network_.running.size());
        unet_.set_parameters(state.parameters, state.running);
        adam_.first_moments().upload(state.moment1);
        adam_.second_moments().upload(state.moment2);
        report.step = state.step;
        entropy_ = state.entropy;
        accuracy_ = state.accuracy;
        before_s_ = state.seconds;
    }
};

}  // namespace
}  // namespace network

RayDropNetwork train_drop_network(Device& device, const std::vector<RayDropImage>& images,
                                  const RayDropNetworkOptions& options, std::uint64_t seed,
                                  const RayDropTrainCallback& progress,
                                  const RayDropTrainState* resume_state) {
    network::RayDropTraining training(device, images, options, seed, resume_state);
    const auto state = [&] { return training.download_state(); };
    while (training.report.step < training.report.n_steps) {
        training.train_on_next_batch();
        if (progress && !progress(training.report, state)) break;
    }
    return training.download_network();
}

}  // namespace relidar
