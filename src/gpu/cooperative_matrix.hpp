// SPDX-License-Identifier: Apache-2.0
#pragma once
// VK_KHR_cooperative_matrix as its specification numbers and lays it out, for Vulkan headers and a volk that are older than it: those of
// Debian 12. Where the headers know the extension, the two are compared when this is compiled.
#include "gpu/vulkan.hpp"

#include <cstddef>
#include <cstdint>

namespace relidar::gpu::cooperative_matrix {

inline constexpr const char* kExtension = "VK_KHR_cooperative_matrix";

/// Chained to features that are asked for, and to those that a device is made with.
struct Features {
    VkStructureType type = VkStructureType(1000506000);
    void* pNext = nullptr;
    VkBool32 cooperativeMatrix = VK_FALSE;
    VkBool32 cooperativeMatrixRobustBufferAccess = VK_FALSE;
};

enum class Component : std::int32_t { float16 = 0, float32 = 1 };
enum class Scope : std::int32_t { subgroup = 3 };

/// A product that a device has: M x K of `a` times K x N of `b`, added to `c`.
struct Properties {
    VkStructureType type = VkStructureType(1000506001);
    void* pNext = nullptr;
    std::uint32_t m = 0, n = 0, k = 0;
    Component a{}, b{}, c{}, result{};
    VkBool32 saturating_accumulation = VK_FALSE;
    Scope scope{};
};

/// Type of vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR.
using GetProperties = VkResult(VKAPI_PTR*)(VkPhysicalDevice, std::uint32_t*, Properties*);
inline constexpr const char* kGetProperties = "vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR";

#ifdef VK_KHR_cooperative_matrix
static_assert(Features{}.type == VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_COOPERATIVE_MATRIX_FEATURES_KHR);
static_assert(sizeof(Features) == sizeof(VkPhysicalDeviceCooperativeMatrixFeaturesKHR));
static_assert(offsetof(Features, cooperativeMatrix) == offsetof(VkPhysicalDeviceCooperativeMatrixFeaturesKHR, cooperativeMatrix));
static_assert(Properties{}.type == VK_STRUCTURE_TYPE_COOPERATIVE_MATRIX_PROPERTIES_KHR);
static_assert(sizeof(Properties) == sizeof(VkCooperativeMatrixPropertiesKHR));
static_assert(offsetof(Properties, m) == offsetof(VkCooperativeMatrixPropertiesKHR, MSize));
static_assert(offsetof(Properties, a) == offsetof(VkCooperativeMatrixPropertiesKHR, AType));
static_assert(offsetof(Properties, result) == offsetof(VkCooperativeMatrixPropertiesKHR, ResultType));
static_assert(offsetof(Properties, scope) == offsetof(VkCooperativeMatrixPropertiesKHR, scope));
static_assert(int(Component::float16) == VK_COMPONENT_TYPE_FLOAT16_KHR && int(Component::float32) == VK_COMPONENT_TYPE_FLOAT32_KHR);
static_assert(int(Scope::subgroup) == VK_SCOPE_SUBGROUP_KHR);
#endif

}  // namespace relidar::gpu::cooperative_matrix
