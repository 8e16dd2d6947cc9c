// SPDX-License-Identifier: Apache-2.0
// Reads the statistics that the driver's compiler reports for a pipeline
// (VK_KHR_pipeline_executable_properties).
#pragma once

#include <relidar/gpu/device.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Needs a pipeline with VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR.
void query_pipeline_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics);

}  // namespace relidar::gpu
