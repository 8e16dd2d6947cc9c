// SPDX-License-Identifier: Apache-2.0
// Implements relidar::Device with Vulkan: an instance, a device and one compute queue.
// Throws a DeviceError if a Vulkan call fails.
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
#include "gpu/launch_limit.hpp"
#include "gpu/memory.hpp"

#include "base/parallel.hpp"
#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class PipelineCache;
class Transfers;

/// Checks the result of a Vulkan call. If the call failed, throws a DeviceError that
/// contains `call` and the name of the VkResult.
void check(VkResult result, const char* call);
/// Throws an error for a failed Vulkan call.
/// @throws DeviceLost if the driver has lost the device
/// @throws DeviceError for all other results
[[noreturn]] void fail(VkResult result, const std::string& message);
std::string get_result_name(VkResult result);

/// Vulkan instance and its debug messenger, which exists only if validation is enabled.
struct Instance {
    VkInstance handle = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    /// Function that destroys the debug messenger of this instance. It is stored per
    /// instance because volk's global pointer becomes null if another instance is opened
    /// without the extension.
    PFN_vkDestroyDebugUtilsMessengerEXT destroy_messenger = nullptr;
    std::atomic<std::size_t> n_messages{0};

    explicit Instance(bool validation);
    ~Instance();
    Instance(const Instance&) = delete;
    Instance& operator=(const Instance&) = delete;

    std::vector<VkPhysicalDevice> physical_devices() const;
};

/// Sets the name of a Vulkan object, which debuggers and the validation layer show. Has
/// no effect if the Vulkan loader lacks VK_EXT_debug_utils.
template <class Handle>
void name_object(VkDevice device, VkObjectType type, Handle handle, const std::string& name) {
    if (!vkSetDebugUtilsObjectNameEXT) return;
    VkDebugUtilsObjectNameInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT};
    info.objectType = type;
    info.objectHandle = reinterpret_cast<std::uint64_t>(handle);
    info.pObjectName = name.c_str();
    vkSetDebugUtilsObjectNameEXT(device, &info);
}

/// Returns true if the physical device supports the extension `name`.
bool has_extension(VkPhysicalDevice physical, const char* name);

/// Collects the names of missing features for an error message.
struct Missing {
    std::string text;
    void need(bool present, const char* name) {
        if (!present) text += (text.empty() ? "" : ", ") + std::string(name);
    }
};

/// Optional device features for subgroups. Kernels rely on this subgroup behaviour.
/// Without these features, the Vulkan specification does not guarantee it.
struct OptionalFeatures {
    /// True if a kernel can request subgroups of exactly DeviceInfo::get_subgroup_size
    /// lanes.
    bool subgroup_size = false;
    /// True if a kernel can request full subgroups, which have no inactive lanes.
    bool full_subgroups = false;
    bool subgroup_uniform_control_flow = false;
    bool maximal_reconvergence = false;
};
OptionalFeatures query_optional_features(VkPhysicalDevice physical);

/// Returns true if kernels can request full subgroups of exactly
/// DeviceInfo::get_subgroup_size lanes.
bool has_known_subgroups(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                         const OptionalFeatures& optional);
/// Lists the features that the software traversal needs and the device lacks. Returns an
/// empty text if no feature is missing.
std::string list_missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                      const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                      const OptionalFeatures& optional);

/// Lists the features that neural networks need and the device lacks. Returns an empty
/// text if no feature is missing.
std::string list_missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                      const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                      const OptionalFeatures& optional);

/// Cache of compute pipelines. The key is the kernel name, its specialisation constants
/// and its subgroup requirements. Kernels with equal keys share one pipeline until the
/// device is closed.
///
/// Sharing saves time because trainings and renderers create dozens of kernels. The CPU
/// driver lavapipe needs 10 ms for each pipeline, even if its code is cached.
///
/// A GPU's driver needs seconds to compile without a cache. Therefore a thread starts to
/// compile a pipeline as soon as its kernel is created.
struct Pipelines {
    struct Made {
        VkResult result;
        VkPipeline pipeline;
    };
    std::mutex mutex;
    std::map<std::string, std::shared_future<Made>> by_key;
    std::counting_semaphore<> compilers{/// Limits the number of threads that compile simultaneously.
                                        std::ptrdiff_t(max_concurrency())};
};

/// Describes a physical device. The description includes the names of all missing
/// features.
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
    std::vector<const char*> extensions;  ///< Device extensions that are enabled.
    gpu::OptionalFeatures optional;       ///< Optional features that are enabled.
    Traversal traversal = Traversal::ray_query;
    float timestamp_period_ns = 1.0f;
    std::uint64_t timestamp_mask = ~std::uint64_t(0);  ///< valid bits of the queue's time stamps
    std::uint32_t workgroup_size = 32;
    std::uint32_t scratch_alignment = 256;
    /// True if a buffer may consist of several allocations (Vulkan's sparse binding).
    bool binds_sparse = false;
    /// Size in bytes, and the name of the Vulkan limit that sets this size.
    struct Limit {
        std::uint64_t n_bytes;
        const char* name;
    };
    /// Maximum size of an array, and maximum size of an allocation. A larger array
    /// consists of several allocations if `binds_sparse` is true.
    Limit largest_buffer{}, largest_allocation{};
    std::unique_ptr<gpu::MemoryPools> memory;
    std::unique_ptr<gpu::Transfers> transfers;
    std::unique_ptr<gpu::PipelineCache> pipeline_cache;
    gpu::Pipelines pipelines;
    gpu::LaunchLimit launch_limit;
    std::mutex queue_mutex;
    /// Layout that all compute pipelines share. The push constants contain two device
    /// addresses.
    VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;
    /// Buffer that contains only zeros. If a launch omits an array, the kernel receives
    /// the address of this buffer.
    std::unique_ptr<Buffer::Impl> nothing;
    std::uint64_t memory_limit_bytes = 0;  ///< Maximum size of all arrays in bytes. 0 means no limit.
    bool compile_only = false;
    /// True if both methods of adding floats (float atomics and compare-and-swap) gave
    /// wrong sums on this device.
    bool wrong_sums = false;
    /// True if every kernel must request DeviceInfo::get_subgroup_size, because the
    /// device check found wrong results with the driver's default size.
    bool forced_lanes = false;
    ForcedWays forced;  ///< Behaviour that a test selects instead of the default.
    /// If true (GPU), pipelines are compiled when their kernels are created. If false
    /// (CPU), each pipeline is compiled at its first launch.
    bool compiles_ahead = false;
    bool pipeline_statistics = false;  ///< True if VK_KHR_pipeline_executable_properties is enabled.
    /// Compiler statistics of the pipelines. Collected only in the mode that compiles
    /// kernels but does not run them.
    std::vector<PipelineStatistics> compiled;
    std::atomic<std::uint64_t> allocated{0};  ///< Total size of all allocated arrays, in bytes.
    std::atomic<std::uint64_t> peak{0};
    /// Number of streams that have recorded commands and not submitted them yet.
    std::atomic<int> n_recording{0};
    /// Buffers that an exception destroyed while such a stream existed. They are freed
    /// later, because the recorded commands may use them.
    struct Orphan {
        VkBuffer handle;
        std::vector<gpu::MemoryPiece> memory;
        gpu::MemoryUse use;
    };
    std::vector<Orphan> orphans;
    std::mutex orphans_mutex;
    /// Number of buffers created, and number of times that the host waited for all
    /// submissions.
    std::atomic<std::uint64_t> n_buffers{0}, n_full_waits{0};

    Impl();
    ~Impl();
    /// Opens the Vulkan device.
    /// @param find_cache_folder folder of the pipeline cache. If empty, no cache file is
    /// used
    void open(const std::filesystem::path& cache_folder);
    void find_compute_queues();
    void make_device();
    void read_limits();
    void make_pipeline_layout();
    /// Submits work to the compute queue. Locks a mutex, because Vulkan allows only one
    /// thread to use a queue at a time.
    void submit(const VkSubmitInfo& work, VkFence fence = VK_NULL_HANDLE);
    /// Waits until the device has finished all submitted work. Ignores errors, because
    /// destructors call this function and a lost device does no more work.
    void wait_idle() noexcept;
    /// Uses several pieces of memory as the memory of one sparse buffer, in the order of
    /// the list. Waits until the queue has done this.
    VkResult bind_pieces(VkBuffer buffer, const std::vector<gpu::MemoryPiece>& pieces);
    void free_buffer(const Orphan& buffer) noexcept;
    /// Frees the buffers that exceptions have destroyed, unless a stream still has
    /// recorded commands.
    void free_orphans();
};

}  // namespace relidar
