// SPDX-License-Identifier: Apache-2.0
// Training of the ray-drop network: images in a new order each epoch, turned by random columns, cross-entropy (Eq. 13), Adam.
#include <chrono>
#include <cmath>
#include <numeric>
#include <random>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "refine/drop_training.hpp"

namespace relidar {
namespace {

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

}  // namespace

DropNetwork train_drop_network(Device& device, const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed,
                               const std::function<bool(const RefineProgress&)>& progress) {
    refine::DropTraining training(device, images, options, seed);
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
