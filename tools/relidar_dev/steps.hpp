// SPDX-License-Identifier: Apache-2.0
// `relidar-dev bench --run RUN --steps N`: measures training steps on batches of a run,
// and the time between their kernels.
#pragma once

#include <string>

#include "train/time_steps.hpp"

namespace relidar::cli {

/// Runs and measures training steps.
/// @param run run folder. Its log must still be at the path that the run was trained
/// from.
StepTimes measure_steps(Device& device, const std::string& run, int n_steps, bool quiet);

std::string steps_text(const StepTimes& times, const Device& device);
std::string steps_json(const StepTimes& times, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
