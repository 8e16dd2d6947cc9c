// SPDX-License-Identifier: Apache-2.0
// What the driver's compiler says of a pipeline (VK_KHR_pipeline_executable_properties), and names of specialisation constants.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>

#include <relidar/gpu.hpp>

#include "gpu/context.hpp"

namespace relidar::gpu {

/// Name of each specialisation constant of a module, by its id (OpDecorate SpecId, OpName).
std::map<std::uint32_t, std::string> constant_names(std::span<const std::uint32_t> words);

/// Fills `statistics.values`, and subgroup_size, from a pipeline made with VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR.
void read_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics);

}  // namespace relidar::gpu
