// SPDX-License-Identifier: Apache-2.0
// Example: trains a scene with a user-defined loss instead of the range loss of the
// settings. CMakeLists.txt compiles the kernel of the loss.
#include <cstdio>

#include <relidar/relidar.hpp>
#include "robust_loss.hpp"

using namespace relidar;

/// Trains a scene on the log DRIVE. Returns 0 if the loss of KERNEL.spv has decreased.
int main(int argc, char** argv) try {
    if (argc != 3) {
        std::fprintf(stderr, "usage: %s DRIVE KERNEL.spv\n", argv[0]);
        return 2;
    }
    Log log = load_log(argv[1], {});
    const Split split = split_frames(log, 10);  // holds out every tenth frame
    Config config = make_preset("quick");
    config.loss.depth = 0.0f;  // The new loss replaces it.
    config.train.iterations = 60;
    config.train.log_every = 10;
    prepare_log(log, split, config);
    Device device;
    RobustLoss loss(device, argv[2], 0.1f, 0.2f);  // weight 0.1, scale 0.2 m
    const auto print_line = [](const TrainProgress& line) {
        std::printf("iteration %d: loss %.4f, of which %.4f is the robust loss\n", line.iteration, line.loss,
                    line.terms[loss_term::custom]);
        return true;  // continues the training
    };
    const TrainResult result = train(device, log, split, config, print_line, {.losses = {&loss}});
    const double first = result.log.front().terms[loss_term::custom],
                 last = result.log.back().terms[loss_term::custom];
    return last < first ? 0 : 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
