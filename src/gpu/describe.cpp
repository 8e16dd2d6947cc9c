// SPDX-License-Identifier: Apache-2.0
// Checks which of the features that relidar needs a physical device supports. Lists all
// missing extensions and features.
#include <algorithm>
#include <cstdio>
#include <cstring>
#include <utility>

#include <fmt/format.h>

#include "gpu/context.hpp"
#include "gpu/swiftshader.hpp"

namespace relidar::gpu {

namespace {

std::vector<VkExtensionProperties> list_device_extensions(VkPhysicalDevice physical) {
    std::uint32_t n = 0;
    check_vulkan_result(vkEnumerateDeviceExtensionProperties(physical, nullptr, &n, nullptr),
                        "vkEnumerateDeviceExtensionProperties");
    std::vector<VkExtensionProperties> extensions(n);
    check_vulkan_result(vkEnumerateDeviceExtensionProperties(physical, nullptr, &n, extensions.data()),
                        "vkEnumerateDeviceExtensionProperties");
    return extensions;
}

const char* get_type_name(VkPhysicalDeviceType type) {
    switch (type) {
        case VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU:
            return "discrete GPU";
        case VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU:
            return "integrated GPU";
        case VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU:
            return "virtual GPU";
        case VK_PHYSICAL_DEVICE_TYPE_CPU:
            return "CPU";
        default:
            return "other";
    }
}

std::uint64_t get_largest_local_heap_bytes(VkPhysicalDevice physical) {
    VkPhysicalDeviceMemoryProperties memory;
    vkGetPhysicalDeviceMemoryProperties(physical, &memory);
    std::uint64_t largest = 0;
    for (std::uint32_t i = 0; i < memory.memoryHeapCount; ++i)
        if (memory.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT)
            largest = std::max<std::uint64_t>(largest, memory.memoryHeaps[i].size);
    return largest;
}

std::string format_vulkan_version(std::uint32_t version) {
    return fmt::format("{}.{}.{}", VK_API_VERSION_MAJOR(version), VK_API_VERSION_MINOR(version),
                       VK_API_VERSION_PATCH(version));
}

constexpr VkSubgroupFeatureFlags kSubgroupOperations =
    VK_SUBGROUP_FEATURE_BASIC_BIT | VK_SUBGROUP_FEATURE_ARITHMETIC_BIT | VK_SUBGROUP_FEATURE_BALLOT_BIT;

bool has_extension(const std::vector<VkExtensionProperties>& extensions, const char* name) {
    return std::any_of(extensions.begin(), extensions.end(), [&](const VkExtensionProperties& e) {
        return std::strcmp(e.extensionName, name) == 0;
    });
}

}  // namespace

OptionalFeatures query_optional_features(VkPhysicalDevice physical) {
    VkPhysicalDeviceSubgroupSizeControlProperties sizes{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES};
    VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &sizes};
    vkGetPhysicalDeviceProperties2(physical, &properties);
    VkPhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR uniform{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_SUBGROUP_UNIFORM_CONTROL_FLOW_FEATURES_KHR};
    VkPhysicalDeviceSubgroupSizeControlFeatures control{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_FEATURES, &uniform};
    VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &control};
    OptionalFeatures optional;
    const std::vector<VkExtensionProperties> extensions = list_device_extensions(physical);
#ifdef VK_KHR_shader_maximal_reconvergence
    VkPhysicalDeviceShaderMaximalReconvergenceFeaturesKHR maximal{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_MAXIMAL_RECONVERGENCE_FEATURES_KHR};
    uniform.pNext = &maximal;
#endif
    vkGetPhysicalDeviceFeatures2(physical, &features);
    optional.subgroup_size = sizes.minSubgroupSize != sizes.maxSubgroupSize && control.subgroupSizeControl &&
                             (sizes.requiredSubgroupSizeStages & VK_SHADER_STAGE_COMPUTE_BIT);
    optional.full_subgroups = control.computeFullSubgroups;
    optional.subgroup_uniform_control_flow =
        has_extension(extensions, VK_KHR_SHADER_SUBGROUP_UNIFORM_CONTROL_FLOW_EXTENSION_NAME) &&
        uniform.shaderSubgroupUniformControlFlow;
#ifdef VK_KHR_shader_maximal_reconvergence
    optional.maximal_reconvergence =
        has_extension(extensions, VK_KHR_SHADER_MAXIMAL_RECONVERGENCE_EXTENSION_NAME) &&
        maximal.shaderMaximalReconvergence;
#endif
    return optional;
}

bool can_require_subgroup_size(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                               const OptionalFeatures& features) {
    return sizes.minSubgroupSize == sizes.maxSubgroupSize ||
           (features.subgroup_size && features.full_subgroups);
}

/// Returns true for Mesa's CPU driver lavapipe before version 24.1. On some CPUs, its
/// compiler terminates the process when it compiles relidar's kernels
/// (docs/debugging.md).
bool is_old_lavapipe(const VkPhysicalDeviceDriverProperties& driver) {
    int major = 0, minor = 0;
    return driver.driverID == VK_DRIVER_ID_MESA_LLVMPIPE &&
           std::sscanf(driver.driverInfo, "Mesa %d.%d", &major, &minor) == 2 &&
           std::pair(major, minor) < std::pair(24, 1);
}

constexpr const char* kNoCompiler = "a driver that can compile the tracing kernels (SwiftShader cannot)";

std::string list_features_missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                               const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                               const OptionalFeatures& optional) {
    const auto operations = [&](VkSubgroupFeatureFlags required) {
        return (subgroup.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) &&
               (subgroup.supportedOperations & required) == required;
    };
    Missing groups;
    groups.add_if_missing(operations(VK_SUBGROUP_FEATURE_VOTE_BIT), "subgroup votes in compute");
    groups.add_if_missing(operations(VK_SUBGROUP_FEATURE_BALLOT_BIT), "subgroup ballots in compute");
    groups.add_if_missing(operations(VK_SUBGROUP_FEATURE_ARITHMETIC_BIT), "subgroup arithmetic in compute");
    groups.add_if_missing(operations(VK_SUBGROUP_FEATURE_SHUFFLE_BIT), "subgroup shuffles in compute");
    groups.add_if_missing(sizes.minSubgroupSize >= 4 && sizes.maxSubgroupSize <= 64,
                          "subgroups with 4 to 64 lanes");
    groups.add_if_missing(can_require_subgroup_size(sizes, optional),
                          "subgroupSizeControl and computeFullSubgroups for subgroups of varying size");
    return groups.text;
}

std::string list_features_missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                               const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                               const OptionalFeatures& optional) {
    Missing groups;
    groups.add_if_missing(subgroup.supportedOperations & VK_SUBGROUP_FEATURE_SHUFFLE_BIT,
                          "subgroup shuffles in compute");
    groups.add_if_missing(can_require_subgroup_size(sizes, optional),
                          "subgroupSizeControl and computeFullSubgroups for subgroups of varying size");
    return groups.text;
}

bool has_extension(VkPhysicalDevice physical, const char* name) {
    return has_extension(list_device_extensions(physical), name);
}

namespace {

/// Returns the names of the features that every kernel needs and the device lacks. Empty
/// if no feature is missing.
std::string list_features_missing_for_kernels(const VkPhysicalDeviceProperties& properties,
                                              const VkPhysicalDeviceDriverProperties& driver,
                                              const VkPhysicalDeviceVulkan12Features& v12,
                                              const VkPhysicalDeviceVulkan13Features& v13,
                                              const VkPhysicalDeviceSubgroupProperties& subgroup) {
    Missing base;
    base.add_if_missing(properties.apiVersion >= VK_API_VERSION_1_3, "Vulkan 1.3");
    base.add_if_missing(!is_old_lavapipe(driver), "lavapipe from Mesa 24.1 or newer");
    base.add_if_missing(v12.bufferDeviceAddress, "bufferDeviceAddress");
    base.add_if_missing(v12.scalarBlockLayout, "scalarBlockLayout");
    base.add_if_missing(v12.timelineSemaphore, "timelineSemaphore");
    base.add_if_missing(v12.hostQueryReset, "hostQueryReset");
    base.add_if_missing(v13.maintenance4, "maintenance4");
    base.add_if_missing((subgroup.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) &&
                            (subgroup.supportedOperations & kSubgroupOperations) == kSubgroupOperations,
                        "subgroup arithmetic and ballots in compute");
    base.add_if_missing(subgroup.subgroupSize >= 4 && subgroup.subgroupSize <= 64,
                        "subgroups with 4 to 64 lanes");
    return base.text;
}

/// Returns the names of the features that ray queries need and the device lacks. Empty if
/// no feature is missing.
std::string list_features_missing_for_ray_query(const std::vector<VkExtensionProperties>& extensions,
                                                const VkPhysicalDeviceAccelerationStructureFeaturesKHR& accel,
                                                const VkPhysicalDeviceRayQueryFeaturesKHR& query) {
    Missing rays;
    for (const char* name : {VK_KHR_ACCELERATION_STRUCTURE_EXTENSION_NAME,
                             VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME, VK_KHR_RAY_QUERY_EXTENSION_NAME})
        rays.add_if_missing(has_extension(extensions, name), name);
    rays.add_if_missing(accel.accelerationStructure, "accelerationStructure");
    rays.add_if_missing(query.rayQuery, "rayQuery");
    return rays.text;
}

}  // namespace

DeviceInfo make_device_info(VkPhysicalDevice physical_device, int index) {
    const std::vector<VkExtensionProperties> extensions = list_device_extensions(physical_device);
    VkPhysicalDeviceDriverProperties driver{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES};
    VkPhysicalDeviceSubgroupSizeControlProperties sizes{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES, &driver};
    VkPhysicalDeviceSubgroupProperties subgroup{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES,
                                                &sizes};
    VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &subgroup};
    vkGetPhysicalDeviceProperties2(physical_device, &properties);

    VkPhysicalDeviceAccelerationStructureFeaturesKHR accel{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_FEATURES_KHR};
    VkPhysicalDeviceRayQueryFeaturesKHR query{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_RAY_QUERY_FEATURES_KHR,
                                              &accel};
    VkPhysicalDeviceShaderAtomicFloatFeaturesEXT atomics{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_ATOMIC_FLOAT_FEATURES_EXT, &query};
    VkPhysicalDeviceVulkan13Features v13{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES, &atomics};
    VkPhysicalDeviceVulkan12Features v12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, &v13};
    VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &v12};
    const bool is_13 = properties.properties.apiVersion >= VK_API_VERSION_1_3;
    if (is_13) vkGetPhysicalDeviceFeatures2(physical_device, &features);
    const OptionalFeatures optional = is_13 ? query_optional_features(physical_device) : OptionalFeatures();

    DeviceInfo info;
    info.index = index;
    info.name = properties.properties.deviceName;
    info.type = get_type_name(properties.properties.deviceType);
    info.driver = fmt::format("{} {}", driver.driverName, driver.driverInfo);
    info.api_version = format_vulkan_version(properties.properties.apiVersion);
    info.memory_bytes = get_largest_local_heap_bytes(physical_device);
    info.subgroup_size = static_cast<int>(subgroup.subgroupSize);
    info.timestamps = properties.properties.limits.timestampComputeAndGraphics != 0;
    info.float_atomics = has_extension(extensions, VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME) &&
                         atomics.shaderBufferFloat32AtomicAdd;

    info.why_not_usable =
        list_features_missing_for_kernels(properties.properties, driver, v12, v13, subgroup);
    info.why_not_ray_query = list_features_missing_for_ray_query(extensions, accel, query);
    info.ray_query = info.why_not_ray_query.empty() && info.why_not_usable.empty();
    info.can_require_subgroup_size = can_require_subgroup_size(sizes, optional);
    info.why_not_software =
        is_swiftshader(info) ? kNoCompiler : list_features_missing_for_software(subgroup, sizes, optional);
    info.software = info.why_not_software.empty() && info.why_not_usable.empty();
    return info;
}

}  // namespace relidar::gpu
