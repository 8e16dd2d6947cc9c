// SPDX-License-Identifier: Apache-2.0
// Training of the ray-drop network: images in a new order each epoch, turned by random columns, cross-entropy (Eq. 13), Adam.
#include <chrono>
#include <cmath>
#include <numeric>
#include <random>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/stages/optimizer.hpp>

#include "refine/drop_inputs.hpp"
#include "refine/drop_loss.hpp"
#include "refine/drop_network.hpp"
#include "refine/unet.hpp"

namespace relidar {
namespace {

constexpr double kLastRate = 0.01;   // share of the first
constexpr std::uint32_t kKeysOfStep = 64;   // for the layers

void check_images(const DropNetwork& network, const std::vector<DropImage>& images) {
    if (images.empty()) throw DataError("training the ray-drop network: found no images, expected at least one");
    double drops = 0.0;
    for (std::size_t i = 0; i < images.size(); ++i) {
        const DropImage& image = images[i];
        refine::check_image(network, image, fmt::format("training the ray-drop network, image {}", i));
        if (image.rows != images[0].rows || image.columns != images[0].columns)
            throw DataError(fmt::format("training the ray-drop network: image {} has {} x {} pixels, expected {} x {} as the first", i,
                                        image.rows, image.columns, images[0].rows, images[0].columns));
        if (image.dropped.empty())
            throw DataError(fmt::format("training the ray-drop network: nothing was measured for image {}, expected drops", i));
        for (const float dropped : image.dropped) drops += dropped > 0.5f;
    }
    if (drops == 0.0)
        throw DataError("training the ray-drop network: found no dropped ray in any frame, expected some: a log of points alone, whose rays are "
                        "not known, has none");
}

/// Sample and turn of each image of an epoch, by a generator of its own, so that no epoch depends on how another one was drawn.
std::vector<refine::DropInputs::Chosen> draw_epoch(std::size_t n, int columns, bool turn, std::uint64_t seed, int epoch) {
    std::mt19937_64 random(seed * 1000003u + std::uint64_t(epoch));
    std::vector<refine::DropInputs::Chosen> chosen(n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t j = random() % (i + 1);   // Fisher and Yates, inside out
        if (i != j) chosen[i].sample = chosen[j].sample;
        chosen[j].sample = std::uint32_t(i);
    }
    for (refine::DropInputs::Chosen& c : chosen) c.turn = turn ? std::uint32_t(random() % std::uint64_t(columns)) : 0;
    return chosen;
}

class DropTraining {
public:
    DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed)
        : network_(start(images, options, seed)),
          options_(options),
          n_images_(images.size()),
          batch_(std::min<std::size_t>(std::size_t(options.batch), images.size())),
          grid_{std::uint32_t(batch_), std::uint32_t(images[0].rows), std::uint32_t(images[0].columns)},
          inputs_(device, network_, images),
          unet_(device, network_),
          loss_(device, grid_.all_pixels()),
          adam_(device, network_.parameters.size(), {.epsilon = 1e-8}),
          stream_(device) {
        unet_.reserve(device, grid_, true);
        stream_.fill(unet_.gradients());   // what lies between groups has none
        stream_.finish();
    }

    std::size_t batch() const { return batch_; }
    std::size_t steps_of_epoch() const { return n_images_ / batch_; }   // the rest of an epoch's images is another one's turn

    /// One step on a batch. @return what it scored before the step
    refine::DropScore step(std::span<const refine::DropInputs::Chosen> chosen, int step, int n_steps) {
        std::size_t known = 0;
        for (const refine::DropInputs::Chosen& c : chosen) known += inputs_.known(c.sample);
        inputs_.make(stream_, chosen, unet_.inputs());
        unet_.forward(stream_, std::uint32_t(step) * kKeysOfStep, float(options_.dropout));
        loss_.run(stream_, grid_.all_pixels(), unet_.logit().values.address(),
                  network_.residual ? inputs_.start().address() : Address<float>(), inputs_.target().address(),
                  unet_.d_logit().values.address(), {}, known);
        unet_.backward(stream_);
        adam_.step(stream_, unet_.parameters(), unet_.gradients(),
                   exponential_schedule(options_.rate, kLastRate * options_.rate, step, n_steps), step);
        stream_.finish();
        return loss_.score(known);
    }

    DropNetwork download() const {
        DropNetwork result = network_;
        result.parameters = unet_.parameters().download();
        result.running = unet_.running().download();
        return result;
    }

private:
    DropNetwork network_;
    RefineOptions options_;
    std::size_t n_images_, batch_;
    refine::Grid grid_;
    refine::DropInputs inputs_;
    refine::Unet unet_;
    refine::DropLoss loss_;
    ArrayAdam adam_;
    Stream stream_;

    static DropNetwork start(const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed) {
        DropNetwork network = refine::shape_of(options);
        check_images(network, images);
        network.normalisation = refine::normalisation_of(images, network.inputs.size());
        refine::initialise(network, refine::UnetPlan(network), seed);
        return network;
    }
};

}  // namespace

DropNetwork train_drop_network(Device& device, const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed,
                               const std::function<bool(const RefineProgress&)>& progress) {
    DropTraining training(device, images, options, seed);
    const auto begin = std::chrono::steady_clock::now();
    const std::size_t n_steps = training.steps_of_epoch(), batch = training.batch();
    RefineProgress told;
    told.n_epochs = options.epochs;
    told.n_steps = options.epochs * int(n_steps);
    for (int epoch = 0; epoch < options.epochs; ++epoch) {
        const auto order = draw_epoch(images.size(), images[0].columns, options.turn, seed, epoch);
        double entropy = 0.0, accuracy = 0.0;
        for (std::size_t k = 0; k < n_steps; ++k) {
            const refine::DropScore score = training.step(std::span(order).subspan(k * batch, batch), ++told.step, told.n_steps);
            entropy += score.entropy;
            accuracy += score.accuracy;
            told.epoch = epoch + 1;
            told.entropy = entropy / double(k + 1);
            told.accuracy = accuracy / double(k + 1);
            told.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
            if (!std::isfinite(score.entropy))
                throw DataError(fmt::format("training the ray-drop network: the loss is {} in step {}, expected a number; try a smaller "
                                            "refine.rate",
                                            score.entropy, told.step));
            if (progress && !progress(told)) return training.download();
        }
    }
    return training.download();
}

}  // namespace relidar
