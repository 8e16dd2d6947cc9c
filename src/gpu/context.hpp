// SPDX-License-Identifier: Apache-2.0
// Vulkan objects behind relidar::Device: instance, device, one compute queue, and how
// failures of calls become DeviceError.
#pragma once

#include <array>
#include <atomic>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <semaphore>
#include <string>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include "gpu/forced.hpp"

#include "base/parallel.hpp"
#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class MemoryPools;
class PipelineCache;
class Transfers;

/// Throws DeviceError naming the call and the VkResult where `result` is a failure.
void check(VkResult result, const char* call);
/// @throws DeviceLost if the driver has lost the device, otherwise DeviceError
[[noreturn]] void fail(VkResult result, const std::string& message);
std::string result_name(VkResult result);

/// An instance with its optional validation messenger.
struct Instance {
    VkInstance handle = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    /// of this instance: one opened later without the extension has none
    PFN_vkDestroyDebugUtilsMessengerEXT destroy_messenger = nullptr;
    std::atomic<std::size_t> n_messages{0};

    explicit Instance(bool validation);
    ~Instance();
    Instance(const Instance&) = delete;
    Instance& operator=(const Instance&) = delete;

    std::vector<VkPhysicalDevice> physical_devices() const;
};

/// Whether a device offers an extension.
bool has_extension(VkPhysicalDevice physical, const char* name);

/// Collects names of what is missing, in words for a message.
struct Missing {
    std::string text;
    void need(bool present, const char* name) {
        if (!present) text += (text.empty() ? "" : ", ") + std::string(name);
    }
};

/// What makes kernels right or safer on devices where it is not so anyway.
struct OptionalFeatures {
    bool subgroup_size = false;   ///< sizes vary, and a kernel can ask for DeviceInfo::subgroup_size lanes
    bool full_subgroups = false;  ///< and that no lane is missing
    bool subgroup_uniform_control_flow = false;
    bool maximal_reconvergence = false;
};
OptionalFeatures optional_features(VkPhysicalDevice physical);

/// Whether subgroups that kernels run in have DeviceInfo::subgroup_size lanes, all there.
bool known_subgroups(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                     const OptionalFeatures& optional);
/// What software traversal lacks, in words; empty where nothing.
std::string missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

/// What layers of networks lack, in the same way.
std::string missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

/// Pipelines by kernel name, specialisation constants and what is expected of subgroups.
/// lavapipe takes 10 ms for one even where its code is in a cache, and trainings and
/// renderers make dozens, so kernels of a device that are alike share one, kept until it
/// closes. A GPU's driver compiles for seconds where nothing is in a cache: there a
/// pipeline is begun, by a thread of its own, as soon as its kernel is made.
struct Pipelines {
    struct Made {
        VkResult result;
        VkPipeline pipeline;
    };
    std::mutex mutex;
    std::map<std::string, std::shared_future<Made>> by_key;
    std::counting_semaphore<> compilers{
        std::ptrdiff_t(max_concurrency())};  ///< threads that may work at a time
};

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
    std::vector<const char*> extensions;  ///< enabled
    gpu::OptionalFeatures optional;       ///< enabled
    Traversal traversal = Traversal::ray_query;
    float timestamp_period_ns = 1.0f;
    std::uint32_t workgroup_size = 32;
    std::uint32_t scratch_alignment = 256;
    /// that one array may have, and which limit that is
    struct {
        std::uint64_t n_bytes;
        const char* name;
    } largest_buffer{};
    std::unique_ptr<gpu::MemoryPools> memory;
    std::unique_ptr<gpu::Transfers> transfers;
    std::unique_ptr<gpu::PipelineCache> pipeline_cache;
    gpu::Pipelines pipelines;
    std::mutex queue_mutex;
    /// shared by all kernels: two addresses as push constants
    VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;
    /// zeros that kernels get in place of an array that a launch leaves out
    std::unique_ptr<Buffer::Impl> nothing;
    std::uint64_t memory_limit_bytes = 0;  ///< 0 = none
    bool compile_only = false;
    ForcedWays forced;  ///< by tests
    /// pipelines are begun with their kernels; a CPU compiles when it runs them
    bool compiles_ahead = false;
    bool pipeline_statistics = false;          ///< VK_KHR_pipeline_executable_properties is enabled
    std::vector<PipelineStatistics> compiled;  ///< where compile_only
    std::atomic<std::uint64_t> allocated{0};   ///< by arrays
    std::atomic<std::uint64_t> peak{0};
    /// made so far; waits of the host for all that was submitted
    std::atomic<std::uint64_t> n_buffers{0}, n_full_waits{0};

    Impl();
    ~Impl();
    /// @param cache_folder  of pipelines, or empty
    void open(const std::filesystem::path& cache_folder);
    void find_compute_queues();
    void make_device();
    void read_limits();
    void make_pipeline_layout();
    /// Hands work to the queue, which takes it from one thread at a time.
    void submit(const VkSubmitInfo& work, VkFence fence = VK_NULL_HANDLE);
};

}  // namespace relidar
