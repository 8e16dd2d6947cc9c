// SPDX-License-Identifier: Apache-2.0
// Vulkan devices of this machine, and an open device. relidar/gpu/stream.hpp has the
// memory and kernel launches of a device.
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
/// structures. `software` uses relidar's own tree, which the tracing kernels walk.
/// `automatic` selects ray query on a GPU that supports it, otherwise software. On a CPU
/// it selects software, which is faster there.
enum class Traversal { automatic, ray_query, software };

/// Returns the traversal method named "auto", "ray_query" or "software", in any case.
/// @throws UsageError for any other name
Traversal find_traversal(const std::string& name);

/// Properties of a Vulkan device of this machine, and the relidar features that it
/// supports.
struct DeviceInfo {
    int index = 0;
    std::string name;
    std::string type;                ///< Device type: "discrete GPU", "integrated GPU", "CPU", ...
    std::string driver;              ///< Driver name and version.
    std::string api_version;         ///< Vulkan version, for example "1.3.240".
    std::uint64_t memory_bytes = 0;  ///< Size of the largest device-local heap, bytes.
    /// True if the device supports ray queries with acceleration structures, in hardware
    /// or in the driver.
    bool ray_query = false;
    /// True if the device supports atomic float addition on buffers. Otherwise kernels
    /// use compare-and-swap.
    bool float_atomics = false;
    int subgroup_size = 1;  ///< Number of invocations in a subgroup.
    /// True if kernels can be forced to run in full subgroups of subgroup_size.
    bool known_subgroups = false;
    bool timestamps = false;  ///< True if compute queues support timestamps.
    /// Names of the features and extensions that ray queries lack. Empty if ray_query is
    /// true.
    std::string why_not_ray_query;
    bool software = false;  ///< True if the device can build and walk relidar's own tree.
    /// Names of the subgroup operations that software traversal lacks. Empty if software
    /// is true.
    std::string why_not_software;
    /// Names of the missing base features. Empty if relidar runs on the device.
    std::string why_not_usable;
};

/// Returns the method that Traversal::automatic selects on a device. Returns `automatic`
/// if no method works.
Traversal best_traversal(const DeviceInfo& info);

/// Lists every Vulkan device in the order of the Vulkan loader.
/// @throws DeviceError if no Vulkan loader or driver is installed
std::vector<DeviceInfo> list_devices();

/// Statistics that the driver reports for a kernel that was compiled with one set of
/// specialisation constants.
struct PipelineStatistics {
    std::string kernel;  ///< Kernel name as in the build: "stage/stem" or "stage/stem@variant".
    /// Specialisation constants in the order of their ids, for example "CHUNK=64
    /// TOGETHER=0".
    std::string constants;
    int workgroup_size = 0;  ///< Threads per workgroup.
    int subgroup_size = 0;   ///< Subgroup size that the driver compiled for; 0 if unknown.
    std::string failure;     ///< Error of the driver if it could not create the pipeline; otherwise empty.
    /// Statistics by the names that the driver gives them. Empty if the driver lacks
    /// VK_KHR_pipeline_executable_properties.
    std::map<std::string, double> values;
};

struct DeviceOptions {
    /// Index in list_devices(). -1 selects the first GPU and prefers GPUs with ray
    /// queries. Without a GPU, it selects a CPU device.
    int index = -1;
    Traversal traversal = Traversal::automatic;
    bool validation = false;  ///< Enables the Khronos validation layer.
    /// Maximum device-local memory that relidar may allocate, bytes; 0 = no limit.
    std::uint64_t memory_limit_bytes = 0;
    /// Compiles each distinct pipeline once, keeps the driver's statistics
    /// (Device::pipelines) and runs no kernel. Use it to inspect pipelines; a driver
    /// without hardware is sufficient.
    bool compile_only = false;
    /// Folder that keeps compiled pipelines between processes. If empty, each process
    /// compiles all pipelines.
    std::filesystem::path pipeline_cache = {};
};

/// Returns the options after applying the user's environment variables. For programs on a
/// user's machine; nothing else in the library reads environment variables.
/// - RELIDAR_VALIDATION=1 enables the validation layer.
/// - RELIDAR_MEMORY_LIMIT_MIB=n applies if the options have no memory limit.
/// - RELIDAR_PIPELINE_CACHE=FOLDER applies if the options have no folder; 0 = no cache.
///   Default: $XDG_CACHE_HOME/relidar or $HOME/.cache/relidar.
/// @throws UsageError if the limit is not a number
DeviceOptions from_environment(DeviceOptions options = {});

/// Open Vulkan device. Destroy all objects created from it before the device.
class Device {
public:
    /// Opens a device.
    /// @throws DeviceError if the device does not exist or lacks features; the message
    /// names all missing features
    explicit Device(const DeviceOptions& options = {});
    ~Device();
    Device(const Device&) = delete;
    Device& operator=(const Device&) = delete;

    const DeviceInfo& info() const;
    /// Returns the traversal method of this device: ray_query or software, never
    /// automatic.
    Traversal traversal() const;
    /// Returns the device memory that arrays occupy, in bytes: now, or the peak since the
    /// device was opened.
    std::uint64_t allocated_bytes() const;
    std::uint64_t peak_bytes() const;
    /// Returns statistics of all pipelines compiled so far, in order, if the device was
    /// opened with compile_only.
    const std::vector<PipelineStatistics>& pipelines() const;

    struct Impl;

private:
    /// Returns the internal implementation; used only inside the library.
    friend Impl& impl_of(const Device& device);
    std::unique_ptr<Impl> impl_;
};

/// Run times of kernels, in milliseconds, over the measured submissions.
struct KernelTimes {
    static constexpr std::ptrdiff_t kLast = 4096;
    struct Total {
        double launches = 0.0, ms = 0.0;
    };
    /// Map from kernel name to one run time per launch, for the last kLast launches.
    std::map<std::string, std::vector<double>> milliseconds;
    /// Number of launches and total run time by kernel name, over all launches.
    std::map<std::string, Total> totals;

    void add(const std::string& kernel, double ms);  ///< Adds the run time of a launch.
    void add(const KernelTimes& later);              ///< Adds the run times of later launches.
};

}  // namespace relidar
