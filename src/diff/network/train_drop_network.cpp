// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network with the cross-entropy loss (Eq. 13) and the Adam
// optimizer. Each epoch shuffles the images and rotates them by a random number of
// columns.
#include <chrono>
#include <cmath>
#include <random>

#include "base/fail.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/drop_training.hpp"

namespace relidar {
namespace {

/// Draws the order of the images and their rotations for one epoch. The seed depends on
/// the epoch, so that a resumed training draws the same values.
std::vector<network::RotatedSample> sample_epoch(std::size_t n, int n_columns, bool rotate,
                                                 std::uint64_t seed, int epoch) {
    std::mt19937_64 random(seed * 1000003u + std::uint64_t(epoch));
    std::vector<network::RotatedSample> chosen(n);
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t j = random() % (i + 1);  // inside-out variant of the Fisher-Yates shuffle
        if (i != j) chosen[i].sample = chosen[j].sample;
        chosen[j].sample = std::uint32_t(i);
    }
    for (network::RotatedSample& c : chosen)
        c.column_shift = rotate ? std::uint32_t(random() % std::uint64_t(n_columns)) : 0;
    return chosen;
}

struct TrainingRunState {
    const std::size_t batch, n_steps;  ///< images per step, steps per epoch
    RayDropTrainProgress report;
    double entropy, accuracy;  ///< sums over the steps of the epoch
    const double before_s;     ///< duration of earlier sessions of this training, s
    const std::chrono::steady_clock::time_point begin = std::chrono::steady_clock::now();

    TrainingRunState(const network::RayDropTraining& training, const RayDropNetworkOptions& options,
                     const RayDropTrainState& start)
        : batch(training.images_per_step()),
          n_steps(training.steps_per_epoch()),
          entropy(start.entropy),
          accuracy(start.accuracy),
          before_s(start.seconds) {
        report.step = start.step;
        report.n_epochs = options.epochs;
        report.n_steps = options.epochs * int(n_steps);
        if (report.step < 0 || report.step > report.n_steps)
            fail(
                "cannot resume the training of the ray-drop network: the saved training is at step {}, "
                "expected 0 to {}, the last step with {} epochs (refine.epochs)",
                report.step, report.n_steps, report.n_epochs);
    }

    int epoch_index() const { return int(std::size_t(report.step - 1) / n_steps); }

    void add_step_score(const network::RayDropScore& score, std::size_t step_in_epoch) {
        entropy += score.entropy;
        accuracy += score.accuracy;
        report.epoch = epoch_index() + 1;
        report.entropy = entropy / double(step_in_epoch + 1);
        report.accuracy = accuracy / double(step_in_epoch + 1);
        report.seconds =
            before_s + std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
        if (!std::isfinite(score.entropy))
            fail(
                "training the ray-drop network failed: the loss is {} in step {}, expected a finite number; "
                "use a smaller value of the setting refine.rate",
                score.entropy, report.step);
    }
};

}  // namespace

RayDropNetwork train_drop_network(Device& device, const std::vector<RayDropImage>& images,
                                  const RayDropNetworkOptions& options, std::uint64_t seed,
                                  const RayDropTrainCallback& progress,
                                  const RayDropTrainState* resume_state) {
    network::RayDropTraining training(device, images, options, seed);
    TrainingRunState course(training, options, resume_state ? *resume_state : RayDropTrainState{});
    if (resume_state) training.restore_state(*resume_state);
    const auto state = [&] {
        RayDropTrainState result = training.download_state();
        result.step = course.report.step;
        result.entropy = course.entropy;
        result.accuracy = course.accuracy;
        result.seconds = course.report.seconds;
        return result;
    };
    std::vector<network::RotatedSample> order;
    while (course.report.step < course.report.n_steps) {
        const std::size_t k = std::size_t(course.report.step++) % course.n_steps;  // step index in the epoch
        if (k == 0) course.entropy = course.accuracy = 0.0;
        // `order` is also empty after a resume within an epoch.
        if (k == 0 || order.empty())
            order = sample_epoch(images.size(), images[0].columns,
                                 network::regularisation_of(options).turns && images[0].circular, seed,
                                 course.epoch_index());
        const auto chosen = std::span(order).subspan(k * course.batch, course.batch);
        course.add_step_score(training.train_on_batch(chosen, course.report.step, course.report.n_steps), k);
        if (progress && !progress(course.report, state)) break;
    }
    return training.download_network();
}

}  // namespace relidar
