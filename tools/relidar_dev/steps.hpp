// SPDX-License-Identifier: Apache-2.0
// `relidar-dev bench --run RUN --steps N`: a training step on the run's own batches, and
// the time between its kernels.
#pragma once

#include <string>

#include "train/time_steps.hpp"

namespace relidar::cli {

/// @param run  folder, whose log is where it was when the run was trained
StepTimes measure_steps(Device& device, const std::string& run, int n_steps, bool quiet);

std::string steps_text(const StepTimes& times, const Device& device);
std::string steps_json(const StepTimes& times, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
