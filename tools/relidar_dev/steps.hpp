// SPDX-License-Identifier: Apache-2.0
// Implements the command `relidar-dev bench --run RUN --steps N`. Measures training steps
// on batches of frames of a run, and the time between kernels.
#pragma once

#include <string>

#include "train/time_steps.hpp"

namespace relidar::cli {

TrainingStepTimes measure_training_steps(Device& device, const std::string& run_folder, int n_steps,
                                         bool quiet);

std::string format_step_times(const TrainingStepTimes& times, const Device& device);
std::string make_step_times_json(const TrainingStepTimes& times, const Device& device,
                                 const std::string& command_line);

}  // namespace relidar::cli
