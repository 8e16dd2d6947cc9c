// SPDX-License-Identifier: Apache-2.0
// Statistics that the driver's compiler reports for a pipeline
// (VK_KHR_pipeline_executable_properties).
#pragma once

#include <relidar/gpu/device.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Sets `statistics.values` and subgroup_size from a pipeline created with
/// VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR.
void read_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics);

}  // namespace relidar::gpu
