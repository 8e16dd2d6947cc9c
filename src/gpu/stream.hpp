// SPDX-License-Identifier: Apache-2.0
// Recording and submission. run() is one call: parameters are copied into memory that
// host and device see, the kernel gets their address, and a full barrier follows.
// Submissions overlap with the host: a slot is reused only when the device is done with
// it.
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
    std::string module;  ///< name of the embedded kernel
    std::string name;    ///< the same without its variant
    std::vector<Constant> constants;
    Subgroups subgroups = Subgroups::any;
    std::uint32_t workgroup_size = 0;           ///< threads
    std::vector<std::uint32_t> addresses = {};  ///< offsets of those in its parameters

    /// Owned by the device, which may still be making it. @throws DeviceError where the
    /// driver rejects it
    VkPipeline pipeline();

private:
    friend class KernelBase;
    std::shared_future<gpu::Pipelines::Made> made_;
    VkPipeline pipeline_ = VK_NULL_HANDLE;
};

struct Stream::Impl {
    static constexpr std::size_t kSlots = 3;             ///< submissions in flight
    static constexpr std::size_t kBlockBytes = 1 << 16;  ///< of host values, at least
    static constexpr std::uint32_t kMaxLaunches = 256;   ///< timed launches of one submission

    struct Slot {
        VkCommandPool pool = VK_NULL_HANDLE;
        VkCommandBuffer commands = VK_NULL_HANDLE;
        VkQueryPool queries = VK_NULL_HANDLE;
        std::vector<std::string> launches;  ///< names, in order of their timestamp pairs
        /// of host values: as many as a submission needed so far
        std::vector<std::unique_ptr<Buffer::Impl>> blocks;
        std::size_t block = 0, block_bytes = 0;                 ///< where the next one goes
        std::vector<std::shared_ptr<const Buffer::Impl>> kept;  ///< until the submission is done
        std::uint64_t ticket = 0;                               ///< 0 = never submitted
    };

    using Command = std::function<void(VkCommandBuffer)>;
    /// What a strand records between two barriers.
    struct Step {
        std::string name;  ///< of the first command
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
    int n_concurrent = 0;              ///< Concurrent scopes that are open
    bool owes_barrier = false;         ///< something was recorded in them
    std::vector<Strand> strands = {};  ///< of the Strands that live
    std::size_t strand = 0;            ///< the chosen one
    bool timed = false;                ///< the launch being recorded is
    bool host_reads = false;           ///< the next barrier is for the host too
    VkSemaphore timeline = VK_NULL_HANDLE;
    std::uint64_t last_ticket = 0;
    std::string last_kernel = "none";
    KernelTimes times;

    Impl(Device& device, bool timing);
    ~Impl();

    /// Command buffer being recorded, begun where needed.
    VkCommandBuffer commands();
    /// Records a command and a barrier behind it; its time is added to those of this
    /// name. In a strand it is kept until record_strands().
    template <class Recorded>
    void record(const std::string& name, Recorded command) {
        if (!strands.empty()) return keep(name, std::move(command));
        begin_timing(name);
        command(commands());
        end_timing();
        barrier();
    }
    void end_concurrent();
    /// Records what the strands hold, the n-th step of each side by side, and leaves them
    /// empty.
    void record_strands();
    /// Where host values lie until the submission is done.
    struct Stored {
        VkBuffer buffer;
        std::size_t offset;
        std::uint64_t address;
    };
    /// Keeps a copy of host values that kernels and copies of this submission read.
    Stored store(const void* bytes, std::size_t n_bytes);
    /// The same as an array of them.
    template <class T>
    Address<T> values(const std::vector<T>& values) {
        return Address<T>(store(values.data(), values.size() * sizeof(T)).address);
    }
    /// Records a copy from host memory into a buffer.
    void write(const Buffer& buffer, const void* bytes, std::size_t n_bytes);
    /// Records a copy into memory that the host reads when the submission is done, and
    /// keeps that memory until then.
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
