// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstring>

#include <fmt/format.h>

#include "gpu/context.hpp"

namespace relidar::gpu {

namespace {

/// Lists the extensions of a device. For a lent device, lists only those that its owner
/// has enabled.
std::vector<VkExtensionProperties> list_extensions(VkPhysicalDevice physical,
                                                   const LentVulkan* lent = nullptr) {
    auto extensions = enumerate<VkExtensionProperties>(
        "vkEnumerateDeviceExtensionProperties", [&](std::uint32_t* n, auto* properties) {
            return vkEnumerateDeviceExtensionProperties(physical, nullptr, n, properties);
        });
    if (lent)
        std::erase_if(extensions, [&](const VkExtensionProperties& extension) {
            return std::ranges::find(lent->extensions, extension.extensionName) == lent->extensions.end();
        });
    return extensions;
}

const char* device_type_name(VkPhysicalDeviceType device_type) {
    if (device_type == VK_PHYSICAL_DEVICE_TYPE_DISCRETE_GPU) return "discrete GPU";
    if (device_type == VK_PHYSICAL_DEVICE_TYPE_INTEGRATED_GPU) return "integrated GPU";
    if (device_type == VK_PHYSICAL_DEVICE_TYPE_VIRTUAL_GPU) return "virtual GPU";
    if (device_type == VK_PHYSICAL_DEVICE_TYPE_CPU) return "CPU";
    return "other";
}

std::uint64_t largest_heap_bytes(VkPhysicalDevice physical) {
    VkPhysicalDeviceMemoryProperties memory;
    vkGetPhysicalDeviceMemoryProperties(physical, &memory);
    std::uint64_t largest = 0;
    for (std::uint32_t i = 0; i < memory.memoryHeapCount; ++i)
        if (memory.memoryHeaps[i].flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT)
            largest = std::max<std::uint64_t>(largest, memory.memoryHeaps[i].size);
    return largest;
}

constexpr VkSubgroupFeatureFlags kSubgroupOperations =
    VK_SUBGROUP_FEATURE_BASIC_BIT | VK_SUBGROUP_FEATURE_ARITHMETIC_BIT | VK_SUBGROUP_FEATURE_BALLOT_BIT;

bool contains_extension(const std::vector<VkExtensionProperties>& extensions, const char* extension_name) {
    return std::any_of(extensions.begin(), extensions.end(), [&](const VkExtensionProperties& e) {
        return std::strcmp(e.extensionName, extension_name) == 0;
    });
}

}  // namespace

bool is_enabled(const LentVulkan* lent, const char* feature_name) {
    return !lent || std::ranges::find(lent->features, feature_name) != lent->features.end();
}

/// Returns which optional features of subgroups the device has. For a lent device, its
/// owner must have enabled them.
OptionalFeatures query_features(VkPhysicalDevice physical, const LentVulkan* lent) {
    const DeviceProperties properties(physical);
    // Vulkan fills a linked list of structs. Each struct points to the next.
    VkPhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR uniform{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_SUBGROUP_UNIFORM_CONTROL_FLOW_FEATURES_KHR};
    VkPhysicalDeviceSubgroupSizeControlFeatures control{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_FEATURES, &uniform};
    VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &control};
#ifdef VK_KHR_shader_maximal_reconvergence
    VkPhysicalDeviceShaderMaximalReconvergenceFeaturesKHR maximal{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_MAXIMAL_RECONVERGENCE_FEATURES_KHR};
    uniform.pNext = &maximal;
#endif
    vkGetPhysicalDeviceFeatures2(physical, &features);
    const std::vector<VkExtensionProperties> extensions = list_extensions(physical, lent);
    const VkPhysicalDeviceSubgroupSizeControlProperties& sizes = properties.subgroup_sizes;
    const bool varies = sizes.minSubgroupSize != sizes.maxSubgroupSize;
    OptionalFeatures optional;
    optional.subgroup_size = varies && control.subgroupSizeControl &&
                             is_enabled(lent, "subgroupSizeControl") &&
                             (sizes.requiredSubgroupSizeStages & VK_SHADER_STAGE_COMPUTE_BIT);
    optional.full_subgroups = control.computeFullSubgroups && is_enabled(lent, "computeFullSubgroups");
    optional.subgroup_uniform_control_flow =
        contains_extension(extensions, VK_KHR_SHADER_SUBGROUP_UNIFORM_CONTROL_FLOW_EXTENSION_NAME) &&
        uniform.shaderSubgroupUniformControlFlow && is_enabled(lent, "shaderSubgroupUniformControlFlow");
#ifdef VK_KHR_shader_maximal_reconvergence
    optional.maximal_reconvergence =
        contains_extension(extensions, VK_KHR_SHADER_MAXIMAL_RECONVERGENCE_EXTENSION_NAME) &&
        maximal.shaderMaximalReconvergence && is_enabled(lent, "shaderMaximalReconvergence");
#endif
    return optional;
}

bool can_fix_subgroup_size(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                           const OptionalFeatures& optional) {
    return sizes.minSubgroupSize == sizes.maxSubgroupSize ||
           (optional.subgroup_size && optional.full_subgroups);
}

/// Returns true if sums of float atomics are too small: lavapipe on arm64 with LLVM 19 or
/// older ignores failed stores on a CPU without LSE atomics (llvm/llvm-project, issue
/// 150988).
bool loses_float_adds([[maybe_unused]] const VkPhysicalDeviceDriverProperties& driver) {
#if defined(__aarch64__)
    constexpr int kFirstCorrectLlvm = 20;
    int llvm = 0;
    const char* version = std::strstr(driver.driverInfo, "LLVM ");
    return driver.driverID == VK_DRIVER_ID_MESA_LLVMPIPE && version &&
           std::sscanf(version, "LLVM %d", &llvm) == 1 && llvm < kFirstCorrectLlvm;
#else
    return false;
#endif
}

/// Returns the missing features that the software traversal needs, as one text.
std::string missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroups,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional) {
    const auto has_operation = [&](VkSubgroupFeatureFlags required) {
        return (subgroups.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) &&
               (subgroups.supportedOperations & required) == required;
    };
    Missing missing;
    missing.require(has_operation(VK_SUBGROUP_FEATURE_VOTE_BIT), "subgroup votes in compute");
    missing.require(has_operation(VK_SUBGROUP_FEATURE_BALLOT_BIT), "subgroup ballots in compute");
    missing.require(has_operation(VK_SUBGROUP_FEATURE_ARITHMETIC_BIT), "subgroup arithmetic in compute");
    missing.require(has_operation(VK_SUBGROUP_FEATURE_SHUFFLE_BIT), "subgroup shuffles in compute");
    missing.require(sizes.minSubgroupSize >= 4 && sizes.maxSubgroupSize <= 64,
                    "subgroups with 4 to 64 lanes");
    missing.require(can_fix_subgroup_size(sizes, optional),
                    "subgroupSizeControl and computeFullSubgroups for subgroups of varying size");
    return missing.text;
}

/// Returns the missing features that the ray-drop network needs, as one text.
std::string missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroups,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional) {
    Missing missing;
    missing.require(subgroups.supportedOperations & VK_SUBGROUP_FEATURE_SHUFFLE_BIT,
                    "subgroup shuffles in compute");
    missing.require(can_fix_subgroup_size(sizes, optional),
                    "subgroupSizeControl and computeFullSubgroups for subgroups of varying size");
    return missing.text;
}

bool has_extension(VkPhysicalDevice physical, const char* extension_name) {
    return contains_extension(list_extensions(physical), extension_name);
}

namespace {

/// Features that kernels, ray queries and gradients need.
struct KernelFeatures {
    VkPhysicalDeviceAccelerationStructureFeaturesKHR accel{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_FEATURES_KHR};
    VkPhysicalDeviceRayQueryFeaturesKHR query{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_RAY_QUERY_FEATURES_KHR,
                                              &accel};
    VkPhysicalDeviceShaderAtomicFloatFeaturesEXT atomics{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_ATOMIC_FLOAT_FEATURES_EXT, &query};
    VkPhysicalDeviceVulkan13Features v13{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES, &atomics};
    VkPhysicalDeviceVulkan12Features v12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, &v13};

    KernelFeatures(VkPhysicalDevice physical, bool has_vulkan_13, const LentVulkan* lent);
    KernelFeatures(const KernelFeatures&) = delete;
    KernelFeatures& operator=(const KernelFeatures&) = delete;
};

/// Reads the features. Those that the owner of a lent device has not enabled are false.
KernelFeatures::KernelFeatures(VkPhysicalDevice physical, bool has_vulkan_13, const LentVulkan* lent) {
    VkPhysicalDeviceFeatures2 all{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &v12};
    if (has_vulkan_13) vkGetPhysicalDeviceFeatures2(physical, &all);
    for (const auto& [feature, name] : std::initializer_list<std::pair<VkBool32*, const char*>>{
             {&v12.bufferDeviceAddress, "bufferDeviceAddress"},
             {&v12.scalarBlockLayout, "scalarBlockLayout"},
             {&v12.timelineSemaphore, "timelineSemaphore"},
             {&v12.hostQueryReset, "hostQueryReset"},
             {&v13.maintenance4, "maintenance4"},
             {&accel.accelerationStructure, "accelerationStructure"},
             {&query.rayQuery, "rayQuery"},
             {&atomics.shaderBufferFloat32AtomicAdd, "shaderBufferFloat32AtomicAdd"}})
        *feature = *feature && is_enabled(lent, name);
}

/// Returns the missing features that all kernels need, as one text.
std::string missing_for_kernels(const DeviceProperties& properties, const KernelFeatures& features) {
    const VkPhysicalDeviceSubgroupProperties& subgroups = properties.subgroups;
    Missing base;
    base.require(properties.base.properties.apiVersion >= VK_API_VERSION_1_3, "Vulkan 1.3");
    // Older compilers of lavapipe terminate the process on some CPUs (docs/debugging.md).
    int mesa_major = 0, mesa_minor = 0;
    const bool is_old_lavapipe =
        properties.driver.driverID == VK_DRIVER_ID_MESA_LLVMPIPE &&
        std::sscanf(properties.driver.driverInfo, "Mesa %d.%d", &mesa_major, &mesa_minor) == 2 &&
        std::pair(mesa_major, mesa_minor) < std::pair(24, 1);
    base.require(!is_old_lavapipe, "lavapipe from Mesa 24.1 or newer");
    base.require(features.v12.bufferDeviceAddress, "bufferDeviceAddress");
    base.require(features.v12.scalarBlockLayout, "scalarBlockLayout");
    base.require(features.v12.timelineSemaphore, "timelineSemaphore");
    base.require(features.v12.hostQueryReset, "hostQueryReset");
    base.require(features.v13.maintenance4, "maintenance4");
    base.require((subgroups.supportedStages & VK_SHADER_STAGE_COMPUTE_BIT) &&
                     (subgroups.supportedOperations & kSubgroupOperations) == kSubgroupOperations,
                 "subgroup arithmetic and ballots in compute");
    base.require(subgroups.subgroupSize >= 4 && subgroups.subgroupSize <= 64, "subgroups with 4 to 64 lanes");
    return base.text;
}

/// Returns the missing extensions and features of ray queries, as one text.
std::string missing_for_ray_query(const std::vector<VkExtensionProperties>& extensions,
                                  const KernelFeatures& features) {
    Missing rays;
    for (const char* name : {VK_KHR_ACCELERATION_STRUCTURE_EXTENSION_NAME,
                             VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME, VK_KHR_RAY_QUERY_EXTENSION_NAME})
        rays.require(contains_extension(extensions, name), name);
    rays.require(features.accel.accelerationStructure, "accelerationStructure");
    rays.require(features.query.rayQuery, "rayQuery");
    return rays.text;
}

}  // namespace

/// Describes a device, and tells what relidar can use it for. Each text why_not_... lists
/// what the device lacks for a use. It is empty if nothing is missing.
DeviceInfo make_device_info(VkPhysicalDevice physical, int device_index, const LentVulkan* lent) {
    const DeviceProperties properties(physical);
    const VkPhysicalDeviceProperties& base = properties.base.properties;
    const bool has_vulkan_13 = base.apiVersion >= VK_API_VERSION_1_3;
    const KernelFeatures features(physical, has_vulkan_13, lent);
    const OptionalFeatures optional = has_vulkan_13 ? query_features(physical, lent) : OptionalFeatures();
    const std::vector<VkExtensionProperties> extensions = list_extensions(physical, lent);

    DeviceInfo info;
    info.index = device_index;
    info.name = base.deviceName;
    info.vendor_id = base.vendorID;
    info.type = device_type_name(base.deviceType);
    info.driver = fmt::format("{} {}", properties.driver.driverName, properties.driver.driverInfo);
    info.api_version =
        fmt::format("{}.{}.{}", VK_API_VERSION_MAJOR(base.apiVersion), VK_API_VERSION_MINOR(base.apiVersion),
                    VK_API_VERSION_PATCH(base.apiVersion));
    info.memory_bytes = largest_heap_bytes(physical);
    info.subgroup_size = static_cast<int>(properties.subgroups.subgroupSize);
    info.can_require_subgroup_size = can_fix_subgroup_size(properties.subgroup_sizes, optional);
    info.timestamps = base.limits.timestampComputeAndGraphics != 0;
    info.float_atomics = contains_extension(extensions, VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME) &&
                         features.atomics.shaderBufferFloat32AtomicAdd &&
                         !loses_float_adds(properties.driver);

    info.why_not_usable = missing_for_kernels(properties, features);
    info.why_not_ray_query = missing_for_ray_query(extensions, features);
    info.why_not_software =
        is_swiftshader(info)
            ? "a driver that can compile the tracing kernels (SwiftShader cannot)"
            : missing_for_software(properties.subgroups, properties.subgroup_sizes, optional);
    const bool is_usable = info.why_not_usable.empty();
    info.ray_query = is_usable && info.why_not_ray_query.empty();
    info.software = is_usable && info.why_not_software.empty();
    return info;
}

}  // namespace relidar::gpu
