// SPDX-License-Identifier: Apache-2.0
// Lists the Vulkan devices of this machine and opens a device. relidar/gpu/stream.hpp
// allocates memory and runs kernels on the device.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace relidar {

/// Method that finds the surfels along a ray. `ray_query` uses the driver's acceleration
/// structures. `software` uses relidar's own tree, which kernels traverse. `automatic`
/// selects ray_query on a GPU that has ray queries, otherwise software. On a CPU device
/// it always selects software, because software traversal is faster there.
enum class RayTracingBackend { automatic, ray_query, software };

/// Returns the traversal method named "auto", "ray_query" or "software". Upper and lower
/// case are equal.
/// @throws UsageError for any other name
RayTracingBackend parse_backend(const std::string& name);

/// Properties of a Vulkan device, and the relidar features that the device supports.
struct DeviceInfo {
    int index = 0;
    std::string name;
    std::uint32_t vendor_id = 0;     ///< Identifier of the maker, for example 0x10DE for NVIDIA.
    std::string type;                ///< Device type: "discrete GPU", "integrated GPU", "CPU", ...
    std::string driver;              ///< Driver name and version.
    std::string api_version;         ///< Vulkan version, for example "1.3.240".
    std::uint64_t memory_bytes = 0;  ///< Size of the largest device-local heap, bytes.
    /// True if the device supports ray queries with acceleration structures. The support
    /// can be in hardware or in the driver.
    bool ray_query = false;
    /// True if the device supports atomic float addition on buffers. Otherwise kernels
    /// use a slower compare-and-swap loop.
    bool float_atomics = false;
    int subgroup_size = 1;  ///< Number of invocations in a subgroup.
    /// True if kernels can require full subgroups with exactly subgroup_size invocations.
    bool can_require_subgroup_size = false;
    bool timestamps = false;  ///< True if compute queues support timestamps.
    /// Names of the missing features and extensions that ray queries require. Empty if
    /// ray_query is true.
    std::string why_not_ray_query;
    bool software = false;  ///< True if the device can build and traverse relidar's own tree.
    /// Names of the missing subgroup operations that software traversal requires. Empty
    /// if software is true.
    std::string why_not_software;
    /// Names of the missing features that relidar always requires. Empty if relidar runs
    /// on the device.
    std::string why_not_usable;
};

/// Returns the method that RayTracingBackend::automatic selects on a device. Returns
/// `automatic` if no method works.
RayTracingBackend best_backend(const DeviceInfo& info);

/// Lists every Vulkan device, in the order of the Vulkan loader.
/// @throws DeviceError if no Vulkan loader or driver is installed
std::vector<DeviceInfo> list_devices();

/// Returns a line about each GPU of the machine that is missing in a list of all devices,
/// because its Vulkan driver is not installed. Detects GPUs on Linux only.
/// @param root  folder that contains the folders dev and sys
std::vector<std::string> find_driverless(const std::vector<DeviceInfo>& devices,
                                         const std::filesystem::path& root = "/");

/// Statistics from the driver for one compiled kernel with one set of specialisation
/// constants.
struct PipelineStatistics {
    std::string kernel;  ///< Kernel name: "stage/stem" or "stage/stem@variant".
    /// Values of the specialisation constants, sorted by their ids, for example "CHUNK=64
    /// TOGETHER=0".
    std::string constants;
    int workgroup_size = 0;  ///< Number of threads per workgroup.
    int subgroup_size = 0;   ///< Subgroup size for which the driver compiled the kernel. 0 if unknown.
    /// Error message of the driver if it could not create the pipeline. Empty if there
    /// was no error.
    std::string failure;
    /// Map from the driver's name of a statistic to its value. Empty if the driver lacks
    /// VK_KHR_pipeline_executable_properties.
    std::map<std::string, double> values;
};

struct DeviceOptions {
    /// Index in list_devices(). -1 selects a suitable device: GPUs before CPU devices,
    /// and devices with ray queries before devices without them.
    int index = -1;
    RayTracingBackend traversal = RayTracingBackend::automatic;
    /// True: reports find_driverless() if a device of the type CPU is selected
    /// automatically.
    bool report_missing_drivers = false;
    bool validation = false;  ///< Enables the Khronos validation layer.
    /// Maximum device-local memory that relidar may allocate, bytes. 0 = no limit.
    std::uint64_t memory_limit_bytes = 0;
    /// If true, other libraries of the process can use the arrays
    /// (Buffer::address_for_others).
    bool share_memory = false;
    /// If true, pipelines are compiled but no kernel runs. Use this option to read the
    /// driver's statistics of each pipeline (Device::statistics). The option
    /// also works with a driver that has no hardware.
    bool compile_only = false;
    /// Folder in which compiled pipelines are cached between processes. If empty, each
    /// process compiles all pipelines.
    std::filesystem::path pipeline_cache = {};
};

/// Changes the options according to the user's environment variables and returns the
/// result. Programs on a user's machine should call this function. No other function of
/// the library reads environment variables.
/// - RELIDAR_VALIDATION=1 enables the validation layer.
/// - Variables of the Vulkan loader such as VK_DRIVER_FILES select drivers. Without them,
///   missing drivers are reported.
/// - RELIDAR_MEMORY_LIMIT_MIB=n applies if the options have no memory limit.
/// - RELIDAR_PIPELINE_CACHE=FOLDER applies if the options have no folder. 0 = no cache.
///   Default: $XDG_CACHE_HOME/relidar or $HOME/.cache/relidar.
/// @throws UsageError if the limit is not a number
DeviceOptions apply_environment(DeviceOptions options = {});

/// Copies between host and device since a device was opened.
struct TransferCounts {
    /// Number and size of the copies of arrays: Buffer, Array, ReadbackBuffer.
    std::uint64_t uploads = 0, upload_bytes = 0, downloads = 0, download_bytes = 0;
    /// Values that commands contain, bytes: kernel parameters, poses, training frames.
    std::uint64_t staged_bytes = 0;
};

/// Vulkan objects that another program, for example a simulator, lends to relidar. The
/// handles are those of vulkan.h, which this header does not include.
struct LentVulkan {
    void* instance = nullptr;         ///< VkInstance, created with an apiVersion of at least 1.3
    void* physical_device = nullptr;  ///< VkPhysicalDevice
    void* device = nullptr;           ///< VkDevice
    /// VkQueue. Vulkan allows only one thread at a time to use a queue, so no other
    /// thread may use it during a call of relidar.
    void* queue = nullptr;
    std::uint32_t queue_family = 0;  ///< Family of the queue. It must support compute.
    /// Names of the device extensions that were enabled, for example "VK_KHR_ray_query".
    std::vector<std::string> extensions = {};
    /// Names of the enabled features as in vulkan.h, for example "bufferDeviceAddress".
    std::vector<std::string> features = {};
};

/// Open Vulkan device. All objects created with a device must be destroyed before the
/// device. Only the process that opened a device can use it: in a forked child, all calls
/// throw a DeviceError, and destructors do nothing.
class Device {
public:
    /// Opens a device.
    /// @throws DeviceError if the device does not exist or lacks features. The message
    /// names all missing features.
    explicit Device(const DeviceOptions& options = {});
    /// Uses a device that another program has opened. Never destroys its objects, which
    /// must outlive this object. Uses only the extensions and features in `lent`.
    /// @param options  the fields that select or validate a device have no effect
    /// @throws DeviceError if a handle is null, or if extensions or features are missing.
    /// The message names all of them.
    static Device from_vulkan(const LentVulkan& lent, const DeviceOptions& options = {});
    ~Device();

    const DeviceInfo& info() const;
    /// @throws DeviceError in a process that was forked after the device was opened
    void check_process() const;
    /// Returns the traversal method of this device: ray_query or software, never
    /// automatic.
    RayTracingBackend backend() const;
    /// Returns the device memory that arrays currently use, bytes. peak_bytes()
    /// returns the maximum since the device was opened.
    std::uint64_t allocated_bytes() const;
    std::uint64_t peak_bytes() const;
    TransferCounts transfers() const;
    /// Returns statistics of all pipelines compiled so far, in the order of compilation.
    /// Empty if the device was not opened with compile_only.
    const std::vector<PipelineStatistics>& statistics() const;

    struct Impl;
    /// Returns the internal implementation. Only the library uses this function.
    Impl& impl() const { return *impl_; }

private:
    explicit Device(std::unique_ptr<Impl> impl);
    std::unique_ptr<Impl> impl_;
};

/// Run times of kernels, milliseconds. Only submissions with enabled timing are measured.
struct KernelTimes {
    static constexpr std::ptrdiff_t kMaxTimes = 4096;
    struct LaunchTotals {
        double launches = 0.0, ms = 0.0;
    };
    /// Run time of each launch by kernel name. Only the last kMaxTimes launches are kept.
    std::map<std::string, std::vector<double>> milliseconds;
    /// Number of launches and their total run time, by kernel name.
    std::map<std::string, LaunchTotals> totals;

    void add_launch_time(const std::string& kernel_name,
                         double duration_ms);        ///< Adds the run time of one launch.
    void add_times(const KernelTimes& later_times);  ///< Adds the run times of later launches.
};

}  // namespace relidar
