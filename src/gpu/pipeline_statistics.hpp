// SPDX-License-Identifier: Apache-2.0
// What the driver's compiler says of a pipeline (VK_KHR_pipeline_executable_properties).
#pragma once

#include <relidar/gpu/device.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Fills `statistics.values`, and subgroup_size, from a pipeline made with
/// VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR.
void read_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics);

}  // namespace relidar::gpu
