// SPDX-License-Identifier: Apache-2.0
// Vulkan objects behind relidar::Device: instance, device, one compute queue, and how failures of calls become DeviceError.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <volk.h>

#include <relidar/gpu.hpp>

namespace relidar::gpu {

/// Throws DeviceError naming the call and the VkResult where `result` is a failure.
void check(VkResult result, const char* call);
std::string result_name(VkResult result);

/// An instance with its optional validation messenger.
struct Instance {
    VkInstance handle = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    std::atomic<std::size_t> n_messages{0};

    explicit Instance(bool validation);
    ~Instance();
    Instance(const Instance&) = delete;
    Instance& operator=(const Instance&) = delete;

    std::vector<VkPhysicalDevice> physical_devices() const;
};

bool has_extension(VkPhysicalDevice physical, const char* name);

/// What relidar can do on a physical device, with every missing piece named.
DeviceInfo describe(VkPhysicalDevice physical, int index);

}  // namespace relidar::gpu

namespace relidar {

struct Device::Impl {
    std::unique_ptr<gpu::Instance> instance;
    VkPhysicalDevice physical = VK_NULL_HANDLE;
    VkDevice device = VK_NULL_HANDLE;
    VkQueue queue = VK_NULL_HANDLE;
    std::uint32_t queue_family = 0;
    DeviceInfo info;
    std::vector<const char*> extensions;   ///< enabled
    Traversal traversal = Traversal::ray_query;
    VkPhysicalDeviceMemoryProperties memory{};
    float timestamp_period_ns = 1.0f;
    std::uint32_t workgroup_size = 32;
    std::uint32_t scratch_alignment = 256;
    VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;   ///< shared by all kernels: one 8-byte push constant
    std::uint64_t memory_limit_bytes = 0;   ///< 0 = none
    bool compile_only = false;
    bool pipeline_statistics = false;       ///< VK_KHR_pipeline_executable_properties is enabled
    std::vector<PipelineStatistics> pipelines;   ///< where compile_only
    std::atomic<std::uint64_t> allocated{0};
    std::atomic<std::uint64_t> peak{0};

    ~Impl();
    void open();
    void read_limits();
    void make_pipeline_layout();
    std::uint32_t memory_type(std::uint32_t allowed, VkMemoryPropertyFlags wanted) const;
};

}  // namespace relidar
