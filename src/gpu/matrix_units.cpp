// SPDX-License-Identifier: Apache-2.0
// Matrix units (VK_KHR_cooperative_matrix): what a device lacks for them, and which sizes of products it offers.
#include <algorithm>

#include "gpu/context.hpp"
#include "gpu/cooperative_matrix.hpp"

namespace relidar::gpu {
namespace {

/// What refine/conv_matrix and refine/conv_weights_matrix need: words of eight halves, and at most 32 KiB of shared memory.
bool suits_kernels(const std::array<int, 3>& size) {
    const auto [m, n, k] = size;
    return m % 8 == 0 && n % 8 == 0 && k % 8 == 0 && m <= 16 && n <= 16 && k <= 32;
}

std::vector<std::array<int, 3>> sizes_of(VkPhysicalDevice physical) {
    using namespace cooperative_matrix;
    const auto get = reinterpret_cast<GetProperties>(vkGetInstanceProcAddr(volkGetLoadedInstance(), kGetProperties));
    if (!get) return {};
    std::uint32_t count = 0;
    check(get(physical, &count, nullptr), kGetProperties);
    std::vector<Properties> all(count);
    check(get(physical, &count, all.data()), kGetProperties);
    std::vector<std::array<int, 3>> sizes;
    for (const Properties& p : all)
        if (p.a == Component::float16 && p.b == Component::float16 && p.c == Component::float32 && p.result == Component::float32 &&
            p.scope == Scope::subgroup)
            sizes.push_back({int(p.m), int(p.n), int(p.k)});
    return sizes;
}

}  // namespace

std::array<int, 3> choose_matrix_size(const std::vector<std::array<int, 3>>& sizes) {
    const std::array<int, 3> best{16, 16, 16};
    if (std::ranges::find(sizes, best) != sizes.end()) return best;
    const auto found = std::ranges::find_if(sizes, suits_kernels);
    return found == sizes.end() ? std::array<int, 3>{} : *found;
}

void describe_matrix_units(VkPhysicalDevice physical, bool is_13, DeviceInfo& info) {
    Missing missing;
    missing.need(is_13, "Vulkan 1.3");
    missing.need(has_extension(physical, cooperative_matrix::kExtension), cooperative_matrix::kExtension);
    if (missing.text.empty()) {
        cooperative_matrix::Features matrices;
        VkPhysicalDeviceVulkan12Features v12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, &matrices};
        VkPhysicalDeviceFeatures2 features{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &v12};
        vkGetPhysicalDeviceFeatures2(physical, &features);
        missing.need(matrices.cooperativeMatrix, "cooperativeMatrix");
        missing.need(v12.shaderFloat16, "shaderFloat16");
        missing.need(v12.vulkanMemoryModel, "vulkanMemoryModel");
        info.matrix_size = choose_matrix_size(sizes_of(physical));
        missing.need(info.matrix_size[0] > 0, "products of halves that a subgroup adds to floats, in a size that there are kernels for");
    }
    info.why_not_matrices = missing.text;
    if (!missing.text.empty()) info.matrix_size = {};
}

}  // namespace relidar::gpu
