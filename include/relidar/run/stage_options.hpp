// SPDX-License-Identifier: Apache-2.0
// Derives options for ray tracing and gradient summation from the settings of a run.
#pragma once

#include <relidar/diff/backward.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

/// Returns the settings with a definite dataset.max_range_m: 0 is replaced by the largest
/// range limit of the log's LiDARs.
Config with_farthest(Config config, const Sequence& sequence);
/// Returns the options for ray tracing that do not depend on the device.
TraceOptions trace_options(const Config& config);
/// Returns the options for ray tracing during training, including outputs that the losses
/// need.
TraceOptions training_trace_options(const Config& config);
/// Returns the options for ray tracing when scans are rendered, including normals and the
/// heaviest surface.
TraceOptions rendering_trace_options(const Config& config);
/// Returns the options for the summation of gradients.
BackwardOptions backward_options(const Config& config);

}  // namespace relidar
