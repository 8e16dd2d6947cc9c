// SPDX-License-Identifier: Apache-2.0
// What settings say to the stages that cast rays and sum their gradients.
#pragma once

#include <relidar/config.hpp>
#include <relidar/sequence.hpp>
#include <relidar/stages/backward.hpp>
#include <relidar/stages/traversal.hpp>

namespace relidar {

/// Settings whose dataset.max_range_m is a length: 0 becomes the farthest limit of the log's LiDARs.
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
