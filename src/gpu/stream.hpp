// SPDX-License-Identifier: Apache-2.0
// Recording and submission of commands. run() copies the parameters to memory that host
// and device share, passes their address to the kernel, and records a full barrier after
// it. Submissions overlap with the host. A slot is reused only after the device has
// finished its submission.
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
    std::string module;  ///< Name of the embedded kernel.
    std::string name;    ///< Name without the variant.
    std::vector<Constant> constants;
    Subgroups subgroups = Subgroups::any;
    std::uint32_t workgroup_size = 0;           ///< Threads per workgroup.
    std::vector<std::uint32_t> addresses = {};  ///< Offsets of the addresses in the parameters.

    /// Returns the pipeline, which belongs to the device. Waits if it is still being
    /// compiled.
    /// @throws DeviceError if the driver rejects the kernel
    VkPipeline pipeline();

private:
    friend class KernelBase;
    std::shared_future<gpu::Pipelines::Made> made_;
    VkPipeline pipeline_ = VK_NULL_HANDLE;
};

struct Stream::Impl {
    static constexpr std::size_t kSlots = 3;  ///< Maximum number of pending submissions.
    /// Minimum size of a block of host values, bytes.
    static constexpr std::size_t kBlockBytes = 1 << 16;
    /// Maximum number of timed launches per submission.
    static constexpr std::uint32_t kMaxLaunches = 256;

    struct Slot {
        VkCommandPool pool = VK_NULL_HANDLE;
        VkCommandBuffer commands = VK_NULL_HANDLE;
        VkQueryPool queries = VK_NULL_HANDLE;
        /// Names of the launches, in the order of their timestamp pairs.
        std::vector<std::string> launches;
        /// Blocks of host values; as many as the largest submission needed so far.
        std::vector<std::unique_ptr<Buffer::Impl>> blocks;
        std::size_t block = 0, block_bytes = 0;  ///< Position of the next host value.
        /// Buffers kept alive until the submission is done.
        std::vector<std::shared_ptr<const Buffer::Impl>> kept;
        std::uint64_t ticket = 0;  ///< Ticket of the submission; 0 = never submitted.
    };

    using Command = std::function<void(VkCommandBuffer)>;
    /// Commands of a strand between two barriers.
    struct Step {
        std::string name;  ///< Name of the first command.
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
    int n_concurrent = 0;  ///< Number of open Concurrent scopes.
    /// True if commands were recorded in these scopes, so that a barrier is still needed.
    bool owes_barrier = false;
    std::vector<Strand> strands = {};  ///< Strands of the current Strands scope.
    std::size_t strand = 0;            ///< Index of the selected strand.
    bool timed = false;                ///< True if the launch that is being recorded has timestamps.
    bool host_reads = false;  ///< True if the next barrier must also make writes visible to the host.
    VkSemaphore timeline = VK_NULL_HANDLE;
    std::uint64_t last_ticket = 0;
    std::string last_kernel = "none";
    KernelTimes times;

    Impl(Device& device, bool timing);
    ~Impl();

    /// Returns the command buffer that is being recorded; starts recording if needed.
    VkCommandBuffer commands();
    /// Records a command and a barrier after it, and adds its time to the times of this
    /// name. In a Strands scope, the command is stored until record_strands().
    template <class Recorded>
    void record(const std::string& name, Recorded command) {
        if (!strands.empty()) return keep(name, std::move(command));
        begin_timing(name);
        command(commands());
        end_timing();
        barrier();
    }
    void end_concurrent();
    /// Records the stored commands of all strands, where the n-th steps of all strands
    /// may run concurrently. The strands are then empty.
    void record_strands();
    /// Location of host values until the submission is done.
    struct Stored {
        VkBuffer buffer;
        std::size_t offset;
        std::uint64_t address;
    };
    /// Stores a copy of host values that kernels and copies of this submission read.
    Stored store(const void* bytes, std::size_t n_bytes);
    /// Stores a copy of an array of host values.
    template <class T>
    Address<T> values(const std::vector<T>& values) {
        return Address<T>(store(values.data(), values.size() * sizeof(T)).address);
    }
    /// Records a copy from host memory to a buffer.
    void write(const Buffer& buffer, const void* bytes, std::size_t n_bytes);
    /// Records a copy to memory that the host reads when the submission is done. Keeps
    /// that memory alive until then.
    void read_back(const Buffer::Impl& from, const std::shared_ptr<const Buffer::Impl>& to,
                   const VkBufferCopy& region);
    void launch(const KernelBase& kernel, std::uint32_t n_threads, const void* params, std::size_t n_bytes);
    void wait(std::uint64_t ticket);
    void collect_times(Slot& slot);

private:
    /// Stores the parameters of a launch, and replaces each address 0 by the address of
    /// `Device::Impl::nothing`.
    /// @return address of the parameters
    std::uint64_t store_parameters(const KernelBase& kernel, const void* bytes, std::size_t n_bytes);
    void keep(const std::string& name, Command command);
    /// Makes earlier writes visible to later commands. In a Concurrent scope, one barrier
    /// is recorded at the end of the scope.
    void barrier();
    void record_barrier();
    void begin_timing(const std::string& name);
    void end_timing();
};

/// Records a kernel launch with n_threads threads. The launch sees the results of all
/// commands recorded before.
template <class Params>
void run(Stream& stream, const Kernel<Params>& kernel, std::size_t n_threads, const Params& params) {
    if (n_threads)
        impl_of(stream).launch(kernel, static_cast<std::uint32_t>(n_threads), &params, sizeof(Params));
}

}  // namespace relidar
