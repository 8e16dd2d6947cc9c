// SPDX-License-Identifier: Apache-2.0
// Vulkan objects that implement relidar::Device: the instance, the device and one compute
// queue. Converts failed Vulkan calls to DeviceError.
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

#include "base/parallel.hpp"
#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class MemoryPools;
class PipelineCache;
class Transfers;

/// Checks the result of a Vulkan call. Throws a DeviceError with the call and the
/// VkResult if it failed.
void check(VkResult result, const char* call);
/// Throws an error for a failed Vulkan call.
/// @throws DeviceLost if the driver has lost the device, otherwise DeviceError
[[noreturn]] void fail(VkResult result, const std::string& message);
std::string result_name(VkResult result);

/// Vulkan instance with its optional validation messenger.
struct Instance {
    VkInstance handle = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    /// Function of this instance that destroys the debug messenger. It is stored here
    /// because opening another instance without the extension sets the global pointer to
    /// null.
    PFN_vkDestroyDebugUtilsMessengerEXT destroy_messenger = nullptr;
    std::atomic<std::size_t> n_messages{0};

    explicit Instance(bool validation);
    ~Instance();
    Instance(const Instance&) = delete;
    Instance& operator=(const Instance&) = delete;

    std::vector<VkPhysicalDevice> physical_devices() const;
};

/// Sets the name of a Vulkan object for debuggers and the validation layer. Has no
/// effect if the Vulkan loader lacks VK_EXT_debug_utils.
template <class Handle>
void name_object(VkDevice device, VkObjectType type, Handle handle, const std::string& name) {
    if (!vkSetDebugUtilsObjectNameEXT) return;
    VkDebugUtilsObjectNameInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT};
    info.objectType = type;
    info.objectHandle = reinterpret_cast<std::uint64_t>(handle);
    info.pObjectName = name.c_str();
    vkSetDebugUtilsObjectNameEXT(device, &info);
}

/// Returns true if a device supports an extension.
bool has_extension(VkPhysicalDevice physical, const char* name);

/// Collects the names of missing features for a message.
struct Missing {
    std::string text;
    void need(bool present, const char* name) {
        if (!present) text += (text.empty() ? "" : ", ") + std::string(name);
    }
};

/// Optional device features that make kernels more robust. Without these features, the
/// Vulkan specification does not guarantee the behaviour of subgroups that the kernels
/// rely on.
struct OptionalFeatures {
    /// True if the subgroup size varies and a kernel can request subgroups of
    /// DeviceInfo::subgroup_size lanes.
    bool subgroup_size = false;
    bool full_subgroups = false;  ///< A kernel can request full subgroups, without inactive lanes.
    bool subgroup_uniform_control_flow = false;
    bool maximal_reconvergence = false;
};
OptionalFeatures optional_features(VkPhysicalDevice physical);

/// Returns true if kernels can run in full subgroups of exactly DeviceInfo::subgroup_size
/// lanes.
bool has_known_subgroups(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                         const OptionalFeatures& optional);
/// Returns a text with the missing features that the software traversal needs. Returns an
/// empty text if none is missing.
std::string missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

/// Returns a text with the missing features that neural networks need. Returns an empty
/// text if none is missing.
std::string missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroup,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

/// Pipelines by kernel name, specialisation constants and subgroup requirements. Equal
/// kernels share one pipeline, which is kept until the device is closed. Sharing is
/// needed because trainings and renderers create dozens of kernels, and lavapipe needs 10
/// ms for each pipeline even if its code is cached. A GPU's driver compiles for seconds
/// without a cache. Therefore a separate thread starts to compile a pipeline as soon as
/// its kernel is created.
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

/// Returns a description of a physical device, including the names of all missing
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
    std::vector<const char*> extensions;  ///< Enabled extensions.
    gpu::OptionalFeatures optional;       ///< Enabled optional features.
    Traversal traversal = Traversal::ray_query;
    float timestamp_period_ns = 1.0f;
    std::uint32_t workgroup_size = 32;
    std::uint32_t scratch_alignment = 256;
    /// Maximum size of one array in bytes, and the name of the device limit that
    /// determines this size.
    struct {
        std::uint64_t n_bytes;
        const char* name;
    } largest_buffer{};
    std::unique_ptr<gpu::MemoryPools> memory;
    std::unique_ptr<gpu::Transfers> transfers;
    std::unique_ptr<gpu::PipelineCache> pipeline_cache;
    gpu::Pipelines pipelines;
    gpu::LaunchLimit launch_limit;
    std::mutex queue_mutex;
    /// Layout of all compute pipelines. The push constants consist of two addresses.
    VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;
    /// Buffer of zeros. A kernel receives its address instead of an array that the launch
    /// omits.
    std::unique_ptr<Buffer::Impl> nothing;
    std::uint64_t memory_limit_bytes = 0;  ///< Limit for the device memory in bytes. 0 means no limit.
    bool compile_only = false;
    bool wrong_sums = false;  ///< True if the device adds floats incorrectly with every method.
    /// True if every kernel must use DeviceInfo::subgroup_size, because the check found
    /// wrong results with the default size of the driver.
    bool forced_lanes = false;
    ForcedWays forced;  ///< Behaviour that tests have forced.
    /// If true, pipelines are compiled when their kernels are created. If false (CPU), a
    /// pipeline is compiled at its first launch.
    bool compiles_ahead = false;
    bool pipeline_statistics = false;  ///< True if VK_KHR_pipeline_executable_properties is enabled.
    /// Statistics of compiled pipelines. Collected only if kernels are compiled but not
    /// run.
    std::vector<PipelineStatistics> compiled;
    std::atomic<std::uint64_t> allocated{0};  ///< Bytes allocated by arrays.
    std::atomic<std::uint64_t> peak{0};
    /// Number of created buffers, and number of times that the host waited for all
    /// submissions.
    std::atomic<std::uint64_t> n_buffers{0}, n_full_waits{0};

    Impl();
    ~Impl();
    /// Opens the Vulkan device.
    /// @param cache_folder folder of the pipeline cache. Empty for no cache file.
    void open(const std::filesystem::path& cache_folder);
    void find_compute_queues();
    void make_device();
    void read_limits();
    void make_pipeline_layout();
    /// Submits work to the compute queue. Locks a mutex, because only one thread may
    /// access the queue at a time.
    void submit(const VkSubmitInfo& work, VkFence fence = VK_NULL_HANDLE);
};

}  // namespace relidar
