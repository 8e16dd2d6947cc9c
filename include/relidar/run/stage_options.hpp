// SPDX-License-Identifier: Apache-2.0
// Converts the settings of a run to options for ray tracing and for the summation of
// gradients.
#pragma once

#include <relidar/diff/backward.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/log.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

/// Returns the settings with a maximum range. If dataset.max_range_m is 0, it becomes the
/// largest range limit of the log's LiDARs.
Config with_max_range(Config config, const Log& log);
/// Returns the options for ray tracing that training and simulation have in common.
TraceOptions common_options(const Config& config);
/// Returns the options for ray tracing during training, with the values that only losses
/// need.
TraceOptions training_options(const Config& config);
/// Returns the options for ray tracing during simulation: with normals if the scene
/// consists of surfels. If render.range is "mode", also with the search for the surface
/// with the largest weight.
TraceOptions rendering_options(const Config& config);
/// Returns the options for the summation of gradients in the backward pass.
BackwardOptions backward_options(const Config& config);

}  // namespace relidar
