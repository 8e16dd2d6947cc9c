// SPDX-License-Identifier: Apache-2.0
// Matrix units (VK_KHR_cooperative_matrix): whether this build has kernels for them, and which sizes of products a device offers.
#include <algorithm>

#include "gpu/context.hpp"
#include "gpu/kernel.hpp"

namespace relidar::gpu {
namespace {

/// What refine/conv_matrix and refine/conv_weights_matrix need: words of eight halves, and at most 32 KiB of shared memory.
bool suits_kernels(const std::array<int, 3>& size) {
    const auto [m, n, k] = size;
    return m % 8 == 0 && n % 8 == 0 && k % 8 == 0 && m <= 16 && n <= 16 && k <= 32;
}

#ifdef VK_KHR_cooperative_matrix
std::vector<std::array<int, 3>> sizes_of(VkPhysicalDevice physical) {
    std::uint32_t n = 0;
    check(vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR(physical, &n, nullptr), "vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR");
    std::vector<VkCooperativeMatrixPropertiesKHR> all(n, {VK_STRUCTURE_TYPE_COOPERATIVE_MATRIX_PROPERTIES_KHR});
    check(vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR(physical, &n, all.data()), "vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR");
    std::vector<std::array<int, 3>> sizes;
    for (const VkCooperativeMatrixPropertiesKHR& p : all)
        if (p.AType == VK_COMPONENT_TYPE_FLOAT16_KHR && p.BType == VK_COMPONENT_TYPE_FLOAT16_KHR &&
            p.CType == VK_COMPONENT_TYPE_FLOAT32_KHR && p.ResultType == VK_COMPONENT_TYPE_FLOAT32_KHR && p.scope == VK_SCOPE_SUBGROUP_KHR)
            sizes.push_back({int(p.MSize), int(p.NSize), int(p.KSize)});
    return sizes;
}
#endif

bool has_kernels() {
    return std::ranges::any_of(embedded_kernels(), [](const EmbeddedKernel& kernel) { return kernel.name == "refine/conv_matrix"; });
}

}  // namespace

std::array<int, 3> choose_matrix_size(const std::vector<std::array<int, 3>>& sizes) {
    const std::array<int, 3> best{16, 16, 16};
    if (std::ranges::find(sizes, best) != sizes.end()) return best;
    const auto found = std::ranges::find_if(sizes, suits_kernels);
    return found == sizes.end() ? std::array<int, 3>{} : *found;
}

void describe_matrix_units([[maybe_unused]] VkPhysicalDevice physical, bool is_13, DeviceInfo& info) {
    Missing missing;
    missing.need(is_13, "Vulkan 1.3");
    missing.need(has_kernels(), "kernels for matrix units: this build's glslang cannot compile them, 14 or newer is needed");
#ifdef VK_KHR_cooperative_matrix
    const bool extension = has_extension(physical, VK_KHR_COOPERATIVE_MATRIX_EXTENSION_NAME);
    missing.need(extension, VK_KHR_COOPERATIVE_MATRIX_EXTENSION_NAME);
    if (missing.text.empty()) {
        VkPhysicalDeviceCooperativeMatrixFeaturesKHR matrices{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_COOPERATIVE_MATRIX_FEATURES_KHR};
        VkPhysicalDeviceVulkan12Features v12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, &matrices};
        VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &v12};
        vkGetPhysicalDeviceFeatures2(physical, &features);
        missing.need(matrices.cooperativeMatrix, "cooperativeMatrix");
        missing.need(v12.shaderFloat16, "shaderFloat16");
        missing.need(v12.vulkanMemoryModel, "vulkanMemoryModel");
        info.matrix_size = choose_matrix_size(sizes_of(physical));
        missing.need(info.matrix_size[0] > 0, "products of halves that a subgroup adds to floats, in a size that there are kernels for");
    }
#else
    missing.need(false, "matrix units in this build's Vulkan headers, 1.3.255 or newer is needed");
#endif
    info.why_not_matrices = missing.text;
    if (!missing.text.empty()) info.matrix_size = {};
}

}  // namespace relidar::gpu
