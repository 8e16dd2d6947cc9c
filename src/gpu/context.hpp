// SPDX-License-Identifier: Apache-2.0
// Implements relidar::Device with Vulkan: an instance, a device and one compute queue.
// Throws a DeviceError if a Vulkan call fails.
#pragma once

#include <future>
#include <optional>
#include <semaphore>

#include <unistd.h>

#include <relidar/gpu/stream.hpp>
#include "gpu/forced.hpp"
#include "gpu/launch_limit.hpp"
#include "gpu/memory.hpp"

#include "base/parallel.hpp"
#include "gpu/vulkan.hpp"

namespace relidar::gpu {

class PipelineCache;
class BufferTransfers;

void vk_check(VkResult result, const char* call_name);
[[noreturn]] void vk_fail(VkResult result, const std::string& message);
std::string vk_result_name(VkResult result);

/// Calls a function with (pointer to a number, pointer to values) twice, as Vulkan lists
/// values.
template <class Value, class Call>
std::vector<Value> enumerate(const char* call_name, const Call& call, const Value& initial = {}) {
    std::uint32_t n = 0;
    vk_check(call(&n, static_cast<Value*>(nullptr)), call_name);
    std::vector<Value> values(n, initial);
    vk_check(call(&n, values.data()), call_name);
    return values;
}

struct VulkanInstance {
    VkInstance handle = VK_NULL_HANDLE;
    VkDebugUtilsMessengerEXT messenger = VK_NULL_HANDLE;
    /// Stored here because volk's global pointer becomes null if an instance without the
    /// extension is opened later.
    PFN_vkDestroyDebugUtilsMessengerEXT destroy_messenger = nullptr;
    std::atomic<std::size_t> n_messages{0};

    explicit VulkanInstance(bool validation);
    ~VulkanInstance();
};

std::vector<VkPhysicalDevice> list_physical_devices(VkInstance instance);

template <class Handle>
void set_object_name(VkDevice device, VkObjectType type, Handle handle, const std::string& name) {
    if (!vkSetDebugUtilsObjectNameEXT) return;
    VkDebugUtilsObjectNameInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_OBJECT_NAME_INFO_EXT};
    info.objectType = type;
    info.objectHandle = reinterpret_cast<std::uint64_t>(handle);
    info.pObjectName = name.c_str();
    vkSetDebugUtilsObjectNameEXT(device, &info);
}

bool has_extension(VkPhysicalDevice physical, const char* extension_name);
/// Returns true if the owner of a lent device has enabled a feature, or if no device is
/// lent.
bool is_enabled(const LentVulkan* lent, const char* feature_name);

/// Its compiler terminates the process on tracing kernels (docs/debugging.md).
inline bool is_swiftshader(const DeviceInfo& info) { return info.driver.starts_with("SwiftShader"); }

struct Missing {
    std::string text;
    void require(bool is_present, const char* feature_name) {
        if (!is_present) text += (text.empty() ? "" : ", ") + std::string(feature_name);
    }
};

/// Kernels also run on devices that behave in this way without a guarantee.
struct OptionalFeatures {
    /// True if a kernel can request subgroups of exactly DeviceInfo::subgroup_size lanes.
    bool subgroup_size = false;
    /// Full subgroups: all lanes are active at the start.
    bool full_subgroups = false;
    bool subgroup_uniform_control_flow = false;
    bool maximal_reconvergence = false;
};
OptionalFeatures query_features(VkPhysicalDevice physical, const LentVulkan* lent = nullptr);

/// Properties of a physical device. The structs point to each other, because the driver
/// fills them as a linked list.
struct DeviceProperties {
    VkPhysicalDeviceAccelerationStructurePropertiesKHR accel{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_PROPERTIES_KHR};
    VkPhysicalDeviceMaintenance4Properties maintenance4{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_4_PROPERTIES, &accel};
    VkPhysicalDeviceMaintenance3Properties maintenance3{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MAINTENANCE_3_PROPERTIES, &maintenance4};
    VkPhysicalDeviceDriverProperties driver{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_DRIVER_PROPERTIES,
                                            &maintenance3};
    VkPhysicalDeviceSubgroupSizeControlProperties subgroup_sizes{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES, &driver};
    VkPhysicalDeviceSubgroupProperties subgroups{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES,
                                                 &subgroup_sizes};
    VkPhysicalDeviceProperties2 base{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &subgroups};

    explicit DeviceProperties(VkPhysicalDevice physical) { vkGetPhysicalDeviceProperties2(physical, &base); }
    DeviceProperties(const DeviceProperties&) = delete;
    DeviceProperties& operator=(const DeviceProperties&) = delete;
};

bool can_fix_subgroup_size(const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                           const OptionalFeatures& optional);
std::string missing_for_software(const VkPhysicalDeviceSubgroupProperties& subgroups,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

std::string missing_for_networks(const VkPhysicalDeviceSubgroupProperties& subgroups,
                                 const VkPhysicalDeviceSubgroupSizeControlProperties& sizes,
                                 const OptionalFeatures& optional);

struct CompiledPipeline {
    VkResult result;
    VkPipeline pipeline;
};

/// Kernels with equal names, constants and subgroup requirements share one pipeline until
/// the device is closed, because trainings and renderers create dozens of kernels.
/// lavapipe needs 10 ms for each pipeline, even if its code is cached. A GPU's driver
/// needs seconds, so a thread compiles a pipeline as soon as its kernel is created.
struct ComputePipelines {
    std::mutex mutex;
    std::map<std::string, std::shared_future<CompiledPipeline>> by_key;
    std::counting_semaphore<> compilers{/// Limits the number of threads that compile simultaneously.
                                        std::ptrdiff_t(max_threads())};
};

/// @param lent if not null, only the extensions and features that its owner has enabled
/// count
DeviceInfo make_device_info(VkPhysicalDevice physical, int device_index, const LentVulkan* lent = nullptr);

}  // namespace relidar::gpu

namespace relidar {

struct Device::Impl {
    std::unique_ptr<gpu::VulkanInstance> instance;  ///< null if the device is lent
    std::optional<LentVulkan> lent;
    const pid_t process = ::getpid();  ///< process that opened the device
    VkPhysicalDevice physical = VK_NULL_HANDLE;
    VkDevice device = VK_NULL_HANDLE;
    VkQueue queue = VK_NULL_HANDLE;
    std::uint32_t queue_family = 0;
    DeviceInfo info;
    std::vector<const char*> extensions;  ///< Device extensions that are enabled.
    gpu::OptionalFeatures optional;       ///< Optional features that are enabled.
    RayTracingBackend traversal = RayTracingBackend::ray_query;
    float timestamp_period_ns = 1.0f;
    std::uint64_t timestamp_mask = ~std::uint64_t(0);  ///< valid bits of the queue's time stamps
    std::uint32_t workgroup_size = 32;
    std::uint32_t scratch_alignment = 256;
    bool binds_sparse = false;
    struct DriverMemoryLimit {
        std::uint64_t n_bytes;
        const char* name;
    };
    DriverMemoryLimit largest_buffer{}, largest_allocation{};
    std::unique_ptr<gpu::DeviceMemoryAllocator> memory;
    std::unique_ptr<gpu::BufferTransfers> transfers;
    std::unique_ptr<gpu::PipelineCache> pipeline_cache;
    gpu::ComputePipelines pipelines;
    gpu::LaunchTimeLimit launch_limit;
    std::mutex queue_mutex;
    /// The push constants are the addresses of the parameter struct and of `nothing`.
    VkPipelineLayout pipeline_layout = VK_NULL_HANDLE;
    /// Zeros. Kernels get this address instead of an array that a launch leaves out.
    std::unique_ptr<Buffer::Impl> nothing;
    std::uint64_t memory_limit_bytes = 0;  ///< Maximum size of all arrays in bytes. 0 means no limit.
    bool share_memory = false, exports_memory = false;
    bool compile_only = false;
    bool wrong_sums = false;
    bool forced_lanes = false;
    ForcedBehaviour forced;  ///< Behaviour that a test has selected instead of the default.
    /// On a GPU. On a CPU, each pipeline is compiled at its first launch.
    bool compiles_ahead = false;
    bool pipeline_statistics = false;  ///< True if VK_KHR_pipeline_executable_properties is enabled.
    std::vector<PipelineStatistics> compiled;
    std::atomic<std::uint64_t> allocated{0};  ///< Total size of all allocated arrays, in bytes.
    std::atomic<std::uint64_t> peak{0};
    std::atomic<int> n_recording{0};
    /// An exception destroyed its owner while a stream had recorded commands that may use
    /// it.
    struct OrphanedBuffer {
        VkBuffer handle;
        std::vector<gpu::MemorySuballocation> memory;
        gpu::BufferPurpose use;
    };
    std::vector<OrphanedBuffer> orphans;
    std::mutex orphans_mutex;
    /// Number of times that the host waited for all submissions.
    std::atomic<std::uint64_t> n_buffers{0}, n_full_waits{0};
    std::atomic<std::uint64_t> n_uploads{0}, upload_bytes{0}, n_downloads{0}, download_bytes{0},
        staged_bytes{0};

    Impl();
    ~Impl();
    void open_device(const DeviceOptions& options);
    void select_traversal(RayTracingBackend requested);
    /// The threads of a driver do not exist in a forked process, so a wait would never
    /// end.
    bool is_forked() const { return ::getpid() != process; }
    void check_process() const;
    const LentVulkan* lender() const { return lent ? &*lent : nullptr; }
    void select_queue();
    void create_device();
    void query_limits();
    void create_layout();
    void submit_to_queue(const VkSubmitInfo& submit_info, VkFence fence = VK_NULL_HANDLE);
    void wait_idle() noexcept;
    VkResult bind_sparse(VkBuffer buffer, const std::vector<gpu::MemorySuballocation>& pieces);
    void destroy_buffer(const OrphanedBuffer& buffer) noexcept;
    void free_orphans();
};

}  // namespace relidar
