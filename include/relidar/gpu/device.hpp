// SPDX-License-Identifier: Apache-2.0
// The Vulkan devices of this machine, and an open one. What runs on it is in
// relidar/gpu/stream.hpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace relidar {

/// How rays find surfels: the driver's acceleration structures and ray queries, or
/// relidar's own tree walked in the tracing kernels. Automatic: ray query on a GPU that
/// has it, else software; software on a CPU, where it is 2 to 4 times faster.
enum class Traversal { automatic, ray_query, software };

/// By name: "auto", "ray_query" or "software", in any case. @throws UsageError for
/// another one
Traversal find_traversal(const std::string& name);

/// One Vulkan device of this machine and what relidar can do with it.
struct DeviceInfo {
    int index = 0;
    std::string name;
    std::string type;                ///< "discrete GPU", "integrated GPU", "CPU", ...
    std::string driver;              ///< driver name and version
    std::string api_version;         ///< "1.3.240"
    std::uint64_t memory_bytes = 0;  ///< of the largest device-local heap
    bool ray_query = false;          ///< hardware (or driver) ray queries with acceleration structures
    bool float_atomics = false;      ///< float atomic add on buffers; otherwise compare-and-swap
    int subgroup_size = 1;           ///< lanes that run together
    /// kernels can be made to run in subgroups of that size, all lanes there
    bool known_subgroups = false;
    bool timestamps = false;        ///< compute timestamps
    std::string why_not_ray_query;  ///< missing extensions and features, empty where ray_query
    bool software = false;          ///< relidar's own tree can be built and walked
    std::string why_not_software;   ///< missing subgroup operations, empty where software
    std::string why_not_usable;     ///< missing base features, empty where relidar runs at all
};

/// What Traversal::automatic means on a device; `automatic` where neither works.
Traversal best_traversal(const DeviceInfo& info);

/// Every Vulkan device, in the loader's order. @throws DeviceError where no Vulkan loader
/// or driver is installed
std::vector<DeviceInfo> list_devices();

/// What the driver's compiler made of one kernel with one set of specialisation
/// constants.
struct PipelineStatistics {
    std::string kernel;      ///< of the build: "stage/stem" or "stage/stem@variant"
    std::string constants;   ///< "CHUNK=64 TOGETHER=0", in the order of their ids
    int workgroup_size = 0;  ///< threads
    int subgroup_size = 0;   ///< lanes the driver compiled for, 0 = unknown
    std::string failure;     ///< the driver's answer where it made no pipeline, else empty
    /// by the driver's own names; empty where it has no
    /// VK_KHR_pipeline_executable_properties
    std::map<std::string, double> values;
};

struct DeviceOptions {
    /// of list_devices; -1 = the first GPU, one with ray query before others, else a CPU
    /// device
    int index = -1;
    Traversal traversal = Traversal::automatic;
    bool validation = false;               ///< Khronos validation layer
    std::uint64_t memory_limit_bytes = 0;  ///< device-local memory it may hold, 0 = all there is
    /// Compile every kernel that is made, each distinct pipeline once, keep what the
    /// driver says of it (Device::pipelines), and run none: what is opened so is for
    /// looking at, and may be a driver without hardware.
    bool compile_only = false;
    /// folder that keeps compiled pipelines from one process to the next; empty: compiled
    /// each time
    std::filesystem::path pipeline_cache = {};
};

/// What a user's environment says, on top of the given options: RELIDAR_VALIDATION=1,
/// RELIDAR_MEMORY_LIMIT_MIB=n (where no limit is given), RELIDAR_PIPELINE_CACHE=FOLDER
/// (0: none; else $XDG_CACHE_HOME/relidar or $HOME/.cache/relidar). For programs that run
/// on a user's machine; nothing else in the library reads the environment. @throws
/// UsageError for a limit that is no number
DeviceOptions from_environment(DeviceOptions options = {});

/// An open device. Everything made from it must be destroyed first.
class Device {
public:
    /// @throws DeviceError naming all missing features at once, or the device that does
    /// not exist
    explicit Device(const DeviceOptions& options = {});
    ~Device();
    Device(const Device&) = delete;
    Device& operator=(const Device&) = delete;

    const DeviceInfo& info() const;
    /// How this device's rays find surfels: ray_query or software, never automatic.
    Traversal traversal() const;
    /// Device memory held by arrays now / at most since the device was opened, bytes.
    std::uint64_t allocated_bytes() const;
    std::uint64_t peak_bytes() const;
    /// What was compiled so far, in that order, where the device was opened to compile
    /// only.
    const std::vector<PipelineStatistics>& pipelines() const;

    struct Impl;

private:
    friend Impl& impl_of(const Device& device);  ///< what the library itself works with
    std::unique_ptr<Impl> impl_;
};

/// Milliseconds a kernel over the submissions measured.
struct KernelTimes {
    static constexpr std::ptrdiff_t kLast = 4096;
    struct Total {
        double launches = 0.0, ms = 0.0;
    };
    /// kernel name -> one entry a launch, of the last kLast launches
    std::map<std::string, std::vector<double>> milliseconds;
    std::map<std::string, Total> totals;  ///< of all launches

    void add(const std::string& kernel, double ms);  ///< one more launch
    void add(const KernelTimes& later);              ///< those of launches that came afterwards
};

}  // namespace relidar
