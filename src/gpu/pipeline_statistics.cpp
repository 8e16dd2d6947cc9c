// SPDX-License-Identifier: Apache-2.0
// Statistics of compiled pipelines, as the driver names them.
#include "gpu/pipeline_statistics.hpp"

#include <cstring>
#include <vector>

namespace relidar::gpu {
namespace {

constexpr std::uint32_t kOpName = 5, kOpDecorate = 71, kSpecId = 1;
constexpr std::size_t kHeaderWords = 5;

double as_double(const VkPipelineExecutableStatisticKHR& s) {
    switch (s.format) {
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_BOOL32_KHR: return s.value.b32 ? 1.0 : 0.0;
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_INT64_KHR: return double(s.value.i64);
        case VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_UINT64_KHR: return double(s.value.u64);
        default: return s.value.f64;
    }
}

}  // namespace

std::map<std::uint32_t, std::string> constant_names(std::span<const std::uint32_t> words) {
    std::map<std::uint32_t, std::string> name_of_result, name_of_constant;   // names come before decorations in a module
    for (std::size_t at = kHeaderWords; at < words.size();) {
        const std::uint32_t n_words = words[at] >> 16, opcode = words[at] & 0xffffu;
        if (n_words == 0 || at + n_words > words.size()) break;
        if (opcode == kOpName) name_of_result[words[at + 1]] = reinterpret_cast<const char*>(&words[at + 2]);
        if (opcode == kOpDecorate && words[at + 2] == kSpecId) name_of_constant[words[at + 3]] = name_of_result[words[at + 1]];
        at += n_words;
    }
    return name_of_constant;
}

void read_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics) {
    VkPipelineInfoKHR info{VK_STRUCTURE_TYPE_PIPELINE_INFO_KHR};
    info.pipeline = pipeline;
    std::uint32_t n = 0;
    check(vkGetPipelineExecutablePropertiesKHR(device, &info, &n, nullptr), "vkGetPipelineExecutablePropertiesKHR");
    std::vector<VkPipelineExecutablePropertiesKHR> executables(n, {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_PROPERTIES_KHR});
    check(vkGetPipelineExecutablePropertiesKHR(device, &info, &n, executables.data()), "vkGetPipelineExecutablePropertiesKHR");
    if (n == 0) return;
    // A compute pipeline is one program; where a driver keeps several widths of it (Intel), the last is the widest.
    statistics.subgroup_size = static_cast<int>(executables[n - 1].subgroupSize);
    VkPipelineExecutableInfoKHR program{VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR};
    program.pipeline = pipeline;
    program.executableIndex = n - 1;
    check(vkGetPipelineExecutableStatisticsKHR(device, &program, &n, nullptr), "vkGetPipelineExecutableStatisticsKHR");
    std::vector<VkPipelineExecutableStatisticKHR> values(n, {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR});
    check(vkGetPipelineExecutableStatisticsKHR(device, &program, &n, values.data()), "vkGetPipelineExecutableStatisticsKHR");
    for (const VkPipelineExecutableStatisticKHR& value : values) statistics.values[value.name] = as_double(value);
}

}  // namespace relidar::gpu
