// SPDX-License-Identifier: Apache-2.0
// What settings say to the stages that cast rays and sum their gradients.
#pragma once

#include <relidar/diff/backward.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

/// Settings whose dataset.max_range_m is a length: 0 becomes the farthest limit of the
/// log's LiDARs.
Config with_farthest(Config config, const Sequence& sequence);
/// How rays are traced. The device decides the rest.
TraceOptions trace_options(const Config& config);
/// The same with what the losses want of rays beside their image.
TraceOptions training_trace_options(const Config& config);
/// The same with what scans want of them: normals, and the heaviest surface.
TraceOptions rendering_trace_options(const Config& config);
/// How gradients are summed.
BackwardOptions backward_options(const Config& config);

}  // namespace relidar
