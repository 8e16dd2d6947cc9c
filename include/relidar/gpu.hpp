// SPDX-License-Identifier: Apache-2.0
// Device, memory and submission, without a Vulkan type: what a stage needs to own arrays and run kernels on them.
// The objects behind these handles live in src/gpu.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace relidar {

/// How rays find surfels: the driver's acceleration structures and ray queries, or relidar's own tree walked in the tracing kernels.
/// Automatic: ray query on a GPU that has it, else software; software on a CPU, where it is 2 to 4 times faster.
enum class Traversal { automatic, ray_query, software };

/// One Vulkan device of this machine and what relidar can do with it.
struct DeviceInfo {
    int index = 0;
    std::string name;
    std::string type;                  ///< "discrete GPU", "integrated GPU", "CPU", ...
    std::string driver;                ///< driver name and version
    std::string api_version;           ///< "1.3.240"
    std::uint64_t memory_bytes = 0;    ///< of the largest device-local heap
    bool ray_query = false;            ///< hardware (or driver) ray queries with acceleration structures
    bool float_atomics = false;        ///< float atomic add on buffers; otherwise compare-and-swap
    int subgroup_size = 1;             ///< lanes that run together
    bool known_subgroups = false;      ///< kernels can be made to run in subgroups of that size, all lanes there
    bool timestamps = false;           ///< compute timestamps
    std::string why_not_ray_query;     ///< missing extensions and features, empty where ray_query
    bool software = false;             ///< relidar's own tree can be built and walked
    std::string why_not_software;      ///< missing subgroup operations, empty where software
    std::string why_not_usable;        ///< missing base features, empty where relidar runs at all
};

/// What Traversal::automatic means on a device; `automatic` where neither works.
Traversal best_traversal(const DeviceInfo& info);

/// Every Vulkan device, in the loader's order. @throws DeviceError where no Vulkan loader or driver is installed
std::vector<DeviceInfo> list_devices();

/// What the driver's compiler made of one kernel with one set of specialisation constants.
struct PipelineStatistics {
    std::string kernel;                     ///< of the build: "stage/stem" or "stage/stem@variant"
    std::string constants;                  ///< "CHUNK=64 TOGETHER=0", in the order of their ids
    int workgroup_size = 0;                 ///< threads
    int subgroup_size = 0;                  ///< lanes the driver compiled for, 0 = unknown
    std::string failure;                    ///< the driver's answer where it made no pipeline, else empty
    std::map<std::string, double> values;   ///< by the driver's own names; empty where it has no VK_KHR_pipeline_executable_properties
};

struct DeviceOptions {
    int index = -1;                              ///< of list_devices; -1 = the first GPU, one with ray query before others, else a CPU device
    Traversal traversal = Traversal::automatic;
    bool validation = false;                     ///< Khronos validation layer; also RELIDAR_VALIDATION=1
    std::uint64_t memory_limit_bytes = 0;        ///< device-local memory it may hold, 0 = all there is; also RELIDAR_MEMORY_LIMIT_MIB=n
    /// Compile every kernel that is made, each distinct pipeline once, keep what the driver says of it (Device::pipelines), and run none:
    /// what is opened so is for looking at, and may be a driver without hardware.
    bool compile_only = false;
};

/// An open device. Everything made from it must be destroyed first.
class Device {
public:
    /// @throws DeviceError naming all missing features at once, or the device that does not exist
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
    /// Validation messages of severity warning or error seen so far (0 without validation).
    std::size_t validation_messages() const;
    /// What was compiled so far, in that order, where the device was opened to compile only.
    const std::vector<PipelineStatistics>& pipelines() const;

    struct Impl;
    Impl& impl() const { return *impl_; }

private:
    std::unique_ptr<Impl> impl_;
};

/// A piece of device memory with an address. Move-only.
class Buffer {
public:
    Buffer();
    /// @param what  name used in messages @throws DeviceError where memory is exhausted, with size and what was asked for
    Buffer(Device& device, std::size_t n_bytes, const std::string& what);
    ~Buffer();
    Buffer(Buffer&&) noexcept;
    Buffer& operator=(Buffer&&) noexcept;

    std::uint64_t address() const;
    std::size_t size_bytes() const;
    explicit operator bool() const { return impl_ != nullptr; }
    /// Blocking copies through staging memory. @throws DeviceError on a lost device
    void upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes = 0);
    void download(void* data, std::size_t n_bytes, std::size_t offset_bytes = 0) const;
    /// Blocking copy of the first bytes of another buffer of the same device.
    void copy_from(const Buffer& source, std::size_t n_bytes);

    struct Impl;
    Impl& impl() const { return *impl_; }

private:
    std::unique_ptr<Impl> impl_;
};

/// Device array of trivially copyable values.
template <class T>
class Array {
public:
    Array() = default;
    Array(Device& device, std::size_t n, const std::string& what) : buffer_(device, (n ? n : 1) * sizeof(T), what), n_(n) {}
    Array(Device& device, std::span<const T> values, const std::string& what) : Array(device, values.size(), what) { upload(values); }

    std::size_t size() const { return n_; }
    std::uint64_t address() const { return buffer_.address(); }
    const Buffer& buffer() const { return buffer_; }
    void upload(std::span<const T> values, std::size_t first = 0) { if (!values.empty()) buffer_.upload(values.data(), values.size_bytes(), first * sizeof(T)); }
    std::vector<T> download() const { return download(n_); }
    /// The first n values.
    std::vector<T> download(std::size_t n) const {
        std::vector<T> values(n);
        if (n) buffer_.download(values.data(), n * sizeof(T));
        return values;
    }
    /// Makes room for n values and keeps those there are; the rest is undefined. Never shrinks. Nothing may be in flight that uses the
    /// array: it moves. @throws DeviceError where memory is exhausted; the array is then as before
    void reserve(Device& device, std::size_t n, const std::string& what) {
        if (n <= n_) return;
        Array larger(device, n, what);
        if (n_) larger.buffer_.copy_from(buffer_, n_ * sizeof(T));
        *this = std::move(larger);
    }

private:
    Buffer buffer_;
    std::size_t n_ = 0;
};

/// Milliseconds a kernel over the submissions measured.
struct KernelTimes {
    std::map<std::string, std::vector<double>> milliseconds;   ///< kernel name -> one entry a launch, at most the last 4096 (older ones are dropped)
};

/// Records kernels and submits them. Each launch sees the results of all earlier ones, but of the same Concurrent scope.
class Stream {
public:
    explicit Stream(Device& device, bool timing = false);
    ~Stream();
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;

    /// Sets an array to a 32-bit pattern.
    void fill(const Buffer& buffer, std::uint32_t pattern = 0);
    template <class T>
    void fill(const Array<T>& array, std::uint32_t pattern = 0) { fill(array.buffer(), pattern); }
    /// Copies the first n_bytes of one buffer to another of the same device.
    void copy(const Buffer& from, const Buffer& to, std::size_t n_bytes);
    /// Submits what was recorded. @return a ticket for wait()
    std::uint64_t submit();
    /// Blocks until a ticket is done. @throws DeviceError on a lost device or a device-side check, with the kernel's name
    void wait(std::uint64_t ticket);
    /// submit and wait.
    void finish() { wait(submit()); }
    /// Times measured so far (only with timing = true and a device with timestamps).
    const KernelTimes& times() const;
    void reset_times();
    Device& device() const;

    struct Impl;
    Impl& impl() const { return *impl_; }

private:
    std::unique_ptr<Impl> impl_;
};

/// While it lives, what a stream records may run at the same time: no launch may read or write what another one of the scope writes.
/// What is recorded afterwards sees the results of all of them.
class Concurrent {
public:
    explicit Concurrent(Stream& stream);
    ~Concurrent();
    Concurrent(const Concurrent&) = delete;
    Concurrent& operator=(const Concurrent&) = delete;

private:
    Stream& stream_;
};

/// A copy of device values that arrives with a later submission.
class Readback {
public:
    /// @param n_bytes at most in one copy @param what name used in messages @throws DeviceError where memory is exhausted
    Readback(Device& device, std::size_t n_bytes, const std::string& what);
    ~Readback();
    Readback(Readback&&) noexcept;
    Readback& operator=(Readback&&) noexcept;

    /// Records a copy of n_bytes into cached host memory. The next submit() of the stream sends it.
    void record(Stream& stream, const Buffer& from, std::size_t n_bytes, std::size_t offset_bytes = 0);
    /// A copy was recorded that wait() has not been called for.
    bool pending() const;
    /// Blocks until the recorded copy is done. @return the bytes, valid until the next record()
    const void* wait(Stream& stream);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
