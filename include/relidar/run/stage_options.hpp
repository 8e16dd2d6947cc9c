// SPDX-License-Identifier: Apache-2.0
// Converts the settings of a run to options for ray tracing and for the summation of
// gradients.
#pragma once

#include <relidar/diff/backward.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

/// Returns the settings with a maximum range. If the setting dataset.max_range_m is 0, it
/// becomes the largest range limit of the log's LiDARs.
Config replace_automatic_max_range(Config config, const LidarSequence& sequence);
/// Returns the options for ray tracing that training and simulation have in common.
TraceOptions make_common_trace_options(const Config& config);
/// Returns the options for ray tracing during training, which enable values that only
/// losses need.
TraceOptions make_training_trace_options(const Config& config);
/// Returns the options for ray tracing during simulation. They enable surface normals if
/// the scene consists of surfels. If render.range is "mode", they also enable the search
/// for the surface with the largest weight on each ray.
TraceOptions make_rendering_trace_options(const Config& config);
/// Returns the options for the summation of gradients in the backward pass.
BackwardOptions make_backward_options(const Config& config);

}  // namespace relidar
