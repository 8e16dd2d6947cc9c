// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network with the cross-entropy loss (Eq. 13) and the Adam
// optimizer. Each epoch shuffles the images and rotates them by a random number of
// columns.
#include <chrono>
#include <cmath>
#include <numeric>
#include <random>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "diff/network/drop_network.hpp"
#include "diff/network/drop_training.hpp"

namespace relidar {
namespace {

/// Draws the order of the images and their rotations for one epoch. The random generator
/// starts anew in each epoch, so that a resumed training gets the same values.
std::vector<refine::DropInputs::Chosen> draw_epoch_order(std::size_t count, int columns, bool turn,
                                                         std::uint64_t seed, int epoch) {
    std::mt19937_64 random(seed * 1000003u + std::uint64_t(epoch));
    std::vector<refine::DropInputs::Chosen> chosen(count);
    for (std::size_t i = 0; i < count; ++i) {
        const std::size_t j = random() % (i + 1);  // inside-out variant of the Fisher-Yates shuffle
        if (i != j) chosen[i].sample = chosen[j].sample;
        chosen[j].sample = std::uint32_t(i);
    }
    for (refine::DropInputs::Chosen& c : chosen)
        c.turn = turn ? std::uint32_t(random() % std::uint64_t(columns)) : 0;
    return chosen;
}

/// State of a training between two steps.
struct Course {
    const std::size_t batch, n_steps;  ///< images per step, steps per epoch
    RefineProgress report;
    double entropy, accuracy;  ///< sums over the steps of the epoch
    const double before_s;     ///< duration of earlier sessions of this training, s
    const std::chrono::steady_clock::time_point begin = std::chrono::steady_clock::now();

    Course(const refine::DropTraining& training, const RefineOptions& options, const RefineState& start)
        : batch(training.batch()),
          n_steps(training.count_steps_per_epoch()),
          entropy(start.entropy),
          accuracy(start.accuracy),
          before_s(start.seconds) {
        report.step = start.step;
        report.n_epochs = options.epochs;
        report.n_steps = options.epochs * int(n_steps);
        if (report.step < 0 || report.step > report.n_steps)
            throw DataError(
                fmt::format("cannot resume the ray-drop network: found step {}, expected at most {}",
                            report.step, report.n_steps));
    }

    /// Increments the step number. After the last step of an epoch, starts the next
    /// epoch.
    /// @return index of the step in its epoch
    std::size_t advance_step() {
        const std::size_t k = std::size_t(report.step++) % n_steps;
        if (k == 0) entropy = accuracy = 0.0;
        return k;
    }
    int epoch() const { return int(std::size_t(report.step - 1) / n_steps); }

    void add(const refine::DropScore& score, std::size_t index) {
        entropy += score.entropy;
        accuracy += score.accuracy;
        report.epoch = epoch() + 1;
        report.entropy = entropy / double(index + 1);
        report.accuracy = accuracy / double(index + 1);
        report.seconds =
            before_s + std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        if (!std::isfinite(score.entropy))
            throw DataError(fmt::format(
                "training the ray-drop network failed: the loss is {} in step {}, expected a finite "
                "number; use a smaller refine.rate",
                score.entropy, report.step));
    }
    RefineState copy_state_into(RefineState state) const {
        state.step = report.step;
        state.entropy = entropy;
        state.accuracy = accuracy;
        state.seconds = report.seconds;
        return state;
    }
};

}  // namespace

DropNetwork train_drop_network(Device& device, const std::vector<DropImage>& images,
                               const RefineOptions& options, std::uint64_t seed,
                               const RefineCallback& progress, const RefineState* start) {
    refine::DropTraining training(device, images, options, seed);
    Course course(training, options, start ? *start : RefineState{});
    if (start) training.restore(*start);
    const auto state = [&] { return course.copy_state_into(training.state()); };
    std::vector<refine::DropInputs::Chosen> order;
    while (course.report.step < course.report.n_steps) {
        const std::size_t k = course.advance_step();
        if (k == 0 || order.empty())
            order = draw_epoch_order(images.size(), images[0].columns,
                                     refine::make_regularisation(options).turns, seed, course.epoch());
        const auto chosen = std::span(order).subspan(k * course.batch, course.batch);
        course.add(training.step(chosen, course.report.step, course.report.n_steps), k);
        if (progress && !progress(course.report, state)) break;
    }
    return training.download();
}

}  // namespace relidar
