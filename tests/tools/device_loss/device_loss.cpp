// SPDX-License-Identifier: Apache-2.0
// Implements a Vulkan layer that simulates a lost device. After RELIDAR_LOSE_DEVICE_AFTER
// submissions, each further submission returns VK_ERROR_DEVICE_LOST, as if the GPU had
// hung or its driver had restarted. Supports a single instance and a single device per
// process.
#include <atomic>
#include <cstdlib>
#include <string_view>

#include <vulkan/vulkan.h>

#include <vulkan/vk_layer.h>

namespace {

struct Next {
    VkInstance instance = nullptr;
    PFN_vkGetInstanceProcAddr of_instance = nullptr;
    PFN_vkGetDeviceProcAddr of_device = nullptr;
    PFN_vkQueueSubmit submit = nullptr;
} next;

std::atomic<long> submissions_left{0};

/// Returns the entry of the creation chain that links this layer to the next layer.
/// @tparam Info VkLayerInstanceCreateInfo or VkLayerDeviceCreateInfo
template <class Info>
Info* find_link_in(const void* chain, VkStructureType type) {
    for (auto* info = static_cast<const Info*>(chain); info; info = static_cast<const Info*>(info->pNext))
        if (info->sType == type && info->function == VK_LAYER_LINK_INFO) return const_cast<Info*>(info);
    return nullptr;
}

VKAPI_ATTR VkResult VKAPI_CALL create_instance(const VkInstanceCreateInfo* info,
                                               const VkAllocationCallbacks* allocator, VkInstance* instance) {
    auto* link =
        find_link_in<VkLayerInstanceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_INSTANCE_CREATE_INFO);
    if (!link) return VK_ERROR_INITIALIZATION_FAILED;
    next.of_instance = link->u.pLayerInfo->pfnNextGetInstanceProcAddr;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;
    const auto create = reinterpret_cast<PFN_vkCreateInstance>(next.of_instance(nullptr, "vkCreateInstance"));
    const VkResult result = create(info, allocator, instance);
    if (result == VK_SUCCESS) next.instance = *instance;
    return result;
}

VKAPI_ATTR VkResult VKAPI_CALL create_device(VkPhysicalDevice physical, const VkDeviceCreateInfo* info,
                                             const VkAllocationCallbacks* allocator, VkDevice* device) {
    auto* link =
        find_link_in<VkLayerDeviceCreateInfo>(info->pNext, VK_STRUCTURE_TYPE_LOADER_DEVICE_CREATE_INFO);
    if (!link) return VK_ERROR_INITIALIZATION_FAILED;
    const auto create = reinterpret_cast<PFN_vkCreateDevice>(
        link->u.pLayerInfo->pfnNextGetInstanceProcAddr(next.instance, "vkCreateDevice"));
    next.of_device = link->u.pLayerInfo->pfnNextGetDeviceProcAddr;
    link->u.pLayerInfo = link->u.pLayerInfo->pNext;
    const VkResult result = create(physical, info, allocator, device);
    if (result != VK_SUCCESS) return result;
    next.submit = reinterpret_cast<PFN_vkQueueSubmit>(next.of_device(*device, "vkQueueSubmit"));
    const char* after = std::getenv("RELIDAR_LOSE_DEVICE_AFTER");
    submissions_left = after ? std::atol(after) : 1L << 40;
    return result;
}

VKAPI_ATTR VkResult VKAPI_CALL submit(VkQueue queue, std::uint32_t count, const VkSubmitInfo* submissions,
                                      VkFence fence) {
    return submissions_left-- > 0 ? next.submit(queue, count, submissions, fence) : VK_ERROR_DEVICE_LOST;
}

PFN_vkVoidFunction of_instance(VkInstance instance, const char* name);
PFN_vkVoidFunction of_device(VkDevice device, const char* name);

/// Returns the functions that this layer implements.
PFN_vkVoidFunction own(std::string_view name) {
    if (name == "vkGetInstanceProcAddr") return reinterpret_cast<PFN_vkVoidFunction>(of_instance);
    if (name == "vkGetDeviceProcAddr") return reinterpret_cast<PFN_vkVoidFunction>(of_device);
    if (name == "vkCreateInstance") return reinterpret_cast<PFN_vkVoidFunction>(create_instance);
    if (name == "vkCreateDevice") return reinterpret_cast<PFN_vkVoidFunction>(create_device);
    if (name == "vkQueueSubmit") return reinterpret_cast<PFN_vkVoidFunction>(submit);
    return nullptr;
}

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL of_instance(VkInstance instance, const char* name) {
    if (const PFN_vkVoidFunction function = own(name)) return function;
    return next.of_instance ? next.of_instance(instance, name) : nullptr;
}

VKAPI_ATTR PFN_vkVoidFunction VKAPI_CALL of_device(VkDevice device, const char* name) {
    if (const PFN_vkVoidFunction function = own(name)) return function;
    return next.of_device(device, name);
}

}  // namespace

extern "C" __attribute__((visibility("default"))) VKAPI_ATTR VkResult VKAPI_CALL
vkNegotiateLoaderLayerInterfaceVersion(VkNegotiateLayerInterface* versions) {
    versions->loaderLayerInterfaceVersion = 2;
    versions->pfnGetInstanceProcAddr = of_instance;
    versions->pfnGetDeviceProcAddr = of_device;
    versions->pfnGetPhysicalDeviceProcAddr = nullptr;
    return VK_SUCCESS;
}
