// SPDX-License-Identifier: Apache-2.0
// Vulkan objects behind relidar::Device: instance, device and one compute queue. Converts
// failed Vulkan calls to DeviceError.
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

/// Throws a DeviceError with the name of the call and the VkResult if `result` is a
/// failure.
void check(VkResult result, const char* call);
/// Throws the error of a failed call.
/// @throws DeviceLost if the driver has lost the device, otherwise DeviceError
[[noreturn]] void fail(VkResult result, const std::string& message);
std::string result_name(VkResult result);

/// A Vulkan instance, with a messenger if validation is enabled.
struct Instance {
    VkInstance handle = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    /// Function of this instance. An instance without the debug extension does not have
    /// it.
    PFN_vkDestroyDebugUtilsMessengerEXT destroy_messenger = nullptr;
    std::atomic<std::size_t> n_messages{0};

    explicit Instance(bool validation);
    ~Instance();
    Instance(const Instance&) = delete;
    Instance& operator=(const Instance&) = delete;

    std::vector<VkPhysicalDevice> physical_devices() const;
};

/// Returns true if a device offers the extension.
bool has_extension(VkPhysicalDevice physical, const char* name);

/// Collects the names of missing features for an error message.
struct Missing {
    std::string text;
    void need(bool present, const char* name) {
        if (!present) text += (text.empty() ? "" : ", ") + std::string(name);
    }
};

/// Optional features that make kernels correct or safer on some devices.
struct OptionalFeatures {
    /// A kernel can request DeviceInfo::subgroup_size lanes although the subgroup size
    /// varies.
    bool subgroup_size = false;
    bool full_subgroups = false;  ///< A kernel can request subgroups without missing lanes.
    bool subgroup_uniform_control_flow = false;
    bool maximal_reconvergence = false;
};
OptionalFeatures optional_features(VkPhysicalDevice physical);

/// Returns true if kernels run in complete subgroups of DeviceInfo::subgroup_size lanes.
bool known_subgroups(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                     const OptionalFeatures& optional);
/// Returns the features that the software traversal needs and the device lacks. Empty if
/// it lacks none.
std::string missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

/// Returns the features that network layers need and the device lacks. Empty if it lacks
/// none.
std::string missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

/// Cache of pipelines, by kernel name, specialisation constants and subgroup
/// requirements. Equal kernels of a device share one pipeline until the device is closed,
/// because lavapipe needs 10 ms for each pipeline even with a warm cache. On a GPU a
/// separate thread starts to compile each pipeline when its kernel is created, because a
/// GPU's compiler can take seconds.
struct Pipelines {
    struct Made {
        VkResult result;
        VkPipeline pipeline;
    };
    std::mutex mutex;
    std::map<std::string, std::shared_future<Made>> by_key;
    /// limits the number of threads that compile simultaneously
    std::counting_semaphore<> compilers{std::ptrdiff_t(n_cores())};
};

/// Returns what relidar can do on a physical device. Names every missing feature.
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
    std::vector<const char*> extensions;  ///< enabled extensions
    gpu::OptionalFeatures optional;       ///< enabled optional features
    Traversal traversal = Traversal::ray_query;
    float timestamp_period_ns = 1.0f;
    std::uint32_t workgroup_size = 32;
    std::uint32_t scratch_alignment = 256;
    /// Largest size of one array in bytes, and the name of the limit that defines it.
    struct {
        std::uint64_t n_bytes;
        const char* name;
    } largest_buffer{};
    std::unique_ptr<gpu::MemoryPools> memory;
    std::unique_ptr<gpu::Transfers> transfers;
    std::unique_ptr<gpu::PipelineCache> pipeline_cache;
    gpu::Pipelines pipelines;
    std::mutex queue_mutex;
    /// Layout of all kernels: two addresses as push constants.
    VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;
    /// Buffer of zeros. A kernel gets its address instead of an array that a launch
    /// leaves out.
    std::unique_ptr<Buffer::Impl> nothing;
    std::uint64_t memory_limit_bytes = 0;  ///< limit for all arrays together in bytes, 0 = no limit
    bool compile_only = false;
    ForcedWays forced;  ///< set by tests only
    /// True if pipelines are compiled when their kernels are created (GPU). False if they
    /// are compiled at their first launch (CPU).
    bool compiles_ahead = false;
    bool pipeline_statistics = false;  ///< true if VK_KHR_pipeline_executable_properties is enabled
    /// statistics of the compiled pipelines, filled if `compile_only` is set
    std::vector<PipelineStatistics> compiled;
    std::atomic<std::uint64_t> allocated{0};  ///< bytes that are allocated for arrays now
    std::atomic<std::uint64_t> peak{0};
    /// Number of buffers created so far, and number of times the host waited for all
    /// submitted work.
    std::atomic<std::uint64_t> n_buffers{0}, n_full_waits{0};

    Impl();
    ~Impl();
    /// Opens the device.
    /// @param cache_folder  folder of the pipeline cache, or empty
    void open(const std::filesystem::path& cache_folder);
    void find_compute_queues();
    void make_device();
    void read_limits();
    void make_pipeline_layout();
    /// Submits work to the queue. Can be called from several threads, because a mutex
    /// protects the queue.
    void submit(const VkSubmitInfo& work, VkFence fence = VK_NULL_HANDLE);
};

}  // namespace relidar
