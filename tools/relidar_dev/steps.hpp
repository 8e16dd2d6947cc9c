// SPDX-License-Identifier: Apache-2.0
// Implements the command `relidar-dev bench --run RUN --steps N`. Measures training steps
// on batches of frames of a run, and the time between kernels.
#pragma once

#include <string>

#include "train/time_steps.hpp"

namespace relidar::cli {

TrainingStepTimes measure_steps(Device& device, const std::string& folder, int n_steps, bool quiet);

std::string format_steps(const TrainingStepTimes& times, const Device& device);
std::string steps_json(const TrainingStepTimes& times, const Device& device, const std::string& args);

}  // namespace relidar::cli
