// SPDX-License-Identifier: Apache-2.0
// Recording and submission of commands. run() copies the parameters into memory that host
// and device share, passes their address to the kernel and adds a full barrier.
// Submissions overlap with the host: a slot is reused when the device has finished it.
#pragma once

#include <array>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "gpu/buffer.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

struct KernelBase::Impl {
    Device::Impl* device = nullptr;
    std::string module;  ///< name of the embedded kernel, with its variant
    std::string name;    ///< name without the variant
    std::vector<Constant> constants;
    Subgroups subgroups = Subgroups::any;
    std::uint32_t workgroup_size = 0;           ///< threads of a workgroup
    std::vector<std::uint32_t> addresses = {};  ///< byte offsets of the addresses in the parameters

    /// Returns the pipeline, and waits for it if the device is still compiling it. The
    /// device owns the pipeline.
    /// @throws DeviceError if the driver rejects the kernel
    VkPipeline pipeline();

private:
    friend class KernelBase;
    std::shared_future<gpu::Pipelines::Made> made_;
    VkPipeline pipeline_ = VK_NULL_HANDLE;
};

struct Stream::Impl {
    static constexpr std::size_t kSlots = 3;             ///< number of submissions in flight
    static constexpr std::size_t kBlockBytes = 1 << 16;  ///< smallest size of a block of host values
    /// largest number of timed launches in one submission
    static constexpr std::uint32_t kMaxLaunches = 256;

    struct Slot {
        VkCommandPool pool = VK_NULL_HANDLE;
        VkCommandBuffer commands = VK_NULL_HANDLE;
        VkQueryPool queries = VK_NULL_HANDLE;
        /// names of the launches, in the order of their timestamp pairs
        std::vector<std::string> launches;
        /// Blocks of host values; as many as the largest submission so far needed.
        std::vector<std::unique_ptr<Buffer::Impl>> blocks;
        std::size_t block = 0, block_bytes = 0;  ///< position of the next host value
        /// buffers that must live until the submission is done
        std::vector<std::shared_ptr<const Buffer::Impl>> kept;
        std::uint64_t ticket = 0;  ///< ticket of the submission, 0 = never submitted
    };

    using Command = std::function<void(VkCommandBuffer)>;
    /// Commands of one strand between two barriers.
    struct Step {
        std::string name;  ///< name of the first command
        std::vector<Command> commands;
        bool closed = false;
    };
    using Strand = std::vector<Step>;

    Device* owner = nullptr;
    Device::Impl* device = nullptr;
    bool timing = false;
    std::array<Slot, kSlots> slots;
    std::size_t current = 0;
    bool recording = false;
    int n_concurrent = 0;              ///< number of open Concurrent scopes
    bool owes_barrier = false;         ///< true if commands were recorded in the open scopes
    std::vector<Strand> strands = {};  ///< one per live Strands object
    std::size_t strand = 0;            ///< index of the current strand
    bool timed = false;                ///< true if the current launch is timed
    bool host_reads = false;           ///< true if the next barrier must make results visible to the host
    VkSemaphore timeline = VK_NULL_HANDLE;
    std::uint64_t last_ticket = 0;
    std::string last_kernel = "none";
    KernelTimes times;

    Impl(Device& device, bool timing);
    ~Impl();

    /// Returns the current command buffer. Begins it if necessary.
    VkCommandBuffer commands();
    /// Records a command and a barrier after it, and adds its time to the times of this
    /// name. In a strand, the command is stored until record_strands().
    template <class Recorded>
    void record(const std::string& name, Recorded command) {
        if (!strands.empty()) return keep(name, std::move(command));
        begin_timing(name);
        command(commands());
        end_timing();
        barrier();
    }
    void end_concurrent();
    /// Records the stored commands of all strands and empties them. The n-th steps of all
    /// strands run simultaneously.
    void record_strands();
    /// Location of host values until the submission is done.
    struct Stored {
        VkBuffer buffer;
        std::size_t offset;
        std::uint64_t address;
    };
    /// Copies host values to memory that kernels and copies of this submission read.
    Stored store(const void* bytes, std::size_t n_bytes);
    /// Copies a vector of host values and returns its device address.
    template <class T>
    Address<T> values(const std::vector<T>& values) {
        return Address<T>(store(values.data(), values.size() * sizeof(T)).address);
    }
    /// Records a copy from host memory into a buffer.
    void write(const Buffer& buffer, const void* bytes, std::size_t n_bytes);
    /// Records a copy into memory that the host reads after the submission is done. Keeps
    /// that memory alive until then.
    void read_back(const Buffer::Impl& from, const std::shared_ptr<const Buffer::Impl>& to,
                   const VkBufferCopy& region);
    void launch(const KernelBase& kernel, std::uint32_t n_threads, const void* params, std::size_t n_bytes);
    void wait(std::uint64_t ticket);
    void collect_times(Slot& slot);

private:
    /// Stores the parameters of a launch, with `Device::Impl::nothing` in place of each
    /// address 0. @return their address
    std::uint64_t store_parameters(const KernelBase& kernel, const void* bytes, std::size_t n_bytes);
    void keep(const std::string& name, Command command);
    /// What is recorded later sees what was recorded before. In a Concurrent scope one
    /// barrier is left for its end.
    void barrier();
    void record_barrier();
    void begin_timing(const std::string& name);
    void end_timing();
};

/// Runs one kernel over n_threads threads. Sees the results of everything recorded
/// before.
template <class Params>
void run(Stream& stream, const Kernel<Params>& kernel, std::size_t n_threads, const Params& params) {
    if (n_threads)
        impl_of(stream).launch(kernel, static_cast<std::uint32_t>(n_threads), &params, sizeof(Params));
}

}  // namespace relidar
