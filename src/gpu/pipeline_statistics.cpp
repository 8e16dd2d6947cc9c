// SPDX-License-Identifier: Apache-2.0
// Reads the compiler statistics of pipelines. Each value keeps the name that the driver
// reports.
#include "gpu/pipeline_statistics.hpp"

#include <vector>

namespace relidar::gpu {
namespace {

double convert_statistic_to_double(const VkPipelineExecutableStatisticKHR& statistic) {
    switch (statistic.format) {
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_BOOL32_KHR:
            return statistic.value.b32 ? 1.0 : 0.0;
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_INT64_KHR:
            return double(statistic.value.i64);
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_UINT64_KHR:
            return double(statistic.value.u64);
        default:
            return statistic.value.f64;
    }
}

}  // namespace

void query_pipeline_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics) {
    VkPipelineInfoKHR info{VK_STRUCTURE_TYPE_PIPELINE_INFO_KHR};
    info.pipeline = pipeline;
    std::uint32_t n = 0;
    throw_unless_vulkan_success(vkGetPipelineExecutablePropertiesKHR(device, &info, &n, nullptr),
                                "vkGetPipelineExecutablePropertiesKHR");
    std::vector<VkPipelineExecutablePropertiesKHR> executables(
        n, {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_PROPERTIES_KHR});
    throw_unless_vulkan_success(vkGetPipelineExecutablePropertiesKHR(device, &info, &n, executables.data()),
                                "vkGetPipelineExecutablePropertiesKHR");
    if (n == 0) return;
    // Some drivers (Intel) compile one executable per subgroup size. The last executable
    // has the largest subgroups.
    statistics.subgroup_size = static_cast<int>(executables[n - 1].subgroupSize);
    VkPipelineExecutableInfoKHR program{VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR};
    program.pipeline = pipeline;
    program.executableIndex = n - 1;
    throw_unless_vulkan_success(vkGetPipelineExecutableStatisticsKHR(device, &program, &n, nullptr),
                                "vkGetPipelineExecutableStatisticsKHR");
    std::vector<VkPipelineExecutableStatisticKHR> values(
        n, {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR});
    throw_unless_vulkan_success(vkGetPipelineExecutableStatisticsKHR(device, &program, &n, values.data()),
                                "vkGetPipelineExecutableStatisticsKHR");
    for (const VkPipelineExecutableStatisticKHR& value : values)
        statistics.values[value.name] = convert_statistic_to_double(value);
}

}  // namespace relidar::gpu
