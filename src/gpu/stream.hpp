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

    /// Returns the compute pipeline, which the device owns. Waits if the pipeline is
    /// still being compiled.
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
        VkCommandBuffer commands = VK_NULL_HANDLE;  ///< Command buffer that is being recorded.
        /// Command buffers of a submission. A long submission has several, which are
        /// submitted in order. The next recording uses them again.
        std::vector<VkCommandBuffer> buffers;
        std::size_t n_buffers = 0;  ///< Number of command buffers of the current recording.
        VkQueryPool queries = VK_NULL_HANDLE;
        /// Launches with timestamps, in the order of their pairs of timestamps.
        struct TimedLaunch {
            std::string name;
            std::uint32_t n_groups;  ///< Number of workgroups. 0 if the speed is not measured.
        };
        std::vector<TimedLaunch> launches;
        /// Memory blocks for values that the host writes. Their number grows to the needs
        /// of the largest submission.
        std::vector<std::unique_ptr<Buffer::Impl>> blocks;
        std::size_t block = 0, block_bytes = 0;  ///< Position of the next host value.
        /// Buffers kept alive until the submission is done.
        std::vector<std::shared_ptr<const Buffer::Impl>> kept;
        std::uint64_t ticket = 0;  ///< Ticket (number) of the submission. 0 if nothing was submitted.
    };

    using Command = std::function<void(VkCommandBuffer)>;
    /// Commands between two barriers in one of several concurrent sequences ("lanes").
    struct Step {
        std::string name;  ///< Name of the first command.
        std::vector<Command> commands;
        bool closed = false;
    };
    using StreamLane = std::vector<Step>;

    Device* owner = nullptr;
    Device::Impl* device = nullptr;
    bool timing = false;
    std::array<Slot, kSlots> slots;
    std::size_t current = 0;
    bool recording = false;
    int n_concurrent = 0;  ///< Number of open Concurrent scopes.
    /// True if commands were recorded in the current scope, so that a barrier is needed
    /// at its end.
    bool owes_barrier = false;
    std::vector<StreamLane> lanes = {};  ///< Concurrent sequences of commands of the current Strands scope.
    std::size_t lane = 0;                ///< Index of the selected lane.
    bool timed = false;                  ///< True if timestamps measure the launch that is being recorded.
    /// True if the next barrier must also make device writes visible to the host.
    bool host_reads = false;
    VkSemaphore timeline = VK_NULL_HANDLE;
    std::uint64_t last_ticket = 0;
    std::string last_kernel = "none";
    /// Expected duration of the commands that were recorded since the last submission.
    double recorded_s = 0.0;
    KernelTimes times;

    Impl(Device& device, bool timing);
    ~Impl();

    /// Returns the command buffer that is being recorded. Starts a new recording if
    /// necessary.
    VkCommandBuffer commands();
    /// Records a command, timestamps and a barrier after it. `name` identifies the
    /// command in the measured times. In a Strands scope, the command is stored until
    /// record_lanes() is called.
    template <class Recorded>
    void record(const std::string& name, Recorded command) {
        if (!lanes.empty()) return keep(name, std::move(command));
        begin_timing(name);
        begin_label(name);
        command(commands());
        end_label();
        end_timing();
        barrier();
    }
    void end_concurrent();
    /// Records the stored commands of several sequences ("lanes"). Step n of one
    /// sequence may run concurrently with step n of the others. Afterwards the sequences
    /// are empty.
    void record_lanes();
    /// Location of host values until the submission is done.
    struct Stored {
        VkBuffer buffer;
        std::size_t offset;
        std::uint64_t address;
    };
    /// Copies values from the host to memory that the kernels of this submission read.
    Stored store(const void* bytes, std::size_t n_bytes);
    /// Stores a copy of an array of host values.
    template <class T>
    Address<T> values(const std::vector<T>& values) {
        return Address<T>(store(values.data(), values.size() * sizeof(T)).address);
    }
    /// Records a copy from host memory to a buffer.
    void write(const Buffer& buffer, const void* bytes, std::size_t n_bytes);
    /// Records a copy from a device buffer to memory that the host reads after the
    /// submission. Keeps the memory alive until then.
    void read_back(const Buffer::Impl& from, const std::shared_ptr<const Buffer::Impl>& to,
                   const VkBufferCopy& region);
    void launch(const KernelBase& kernel, std::uint32_t n_threads, const void* params, std::size_t n_bytes);
    void wait(std::uint64_t ticket);
    void collect_times(Slot& slot);
    struct Dispatch;

private:
    /// Stores the parameters of a launch for the kernel. Replaces each address 0 by the
    /// address of a buffer with zeros.
    /// @return device address of the parameters
    std::uint64_t store_parameters(const KernelBase& kernel, const void* bytes, std::size_t n_bytes);
    void keep(const std::string& name, Command command);
    /// Makes earlier device writes visible to later commands. In a Concurrent scope, only
    /// one barrier is recorded, at the end of the scope.
    void barrier();
    void record_barrier();
    /// @param n_groups number of workgroups of a launch whose speed may be measured, or 0
    void begin_timing(const std::string& name, std::uint32_t n_groups = 0);
    void end_timing();
    /// Begins or ends a region that debuggers show with a name.
    void begin_label(const std::string& name);
    void end_label();
    void record_pieces(const std::string& name, const Dispatch& dispatch);
    void begin_buffer(Slot& slot);
    /// Submits the commands recorded so far. The recording continues in a new command
    /// buffer of the same submission.
    void submit_part();
};

/// Records a kernel launch with n_threads threads. The kernel sees the results of all
/// commands that were recorded before.
template <class Params>
void run(Stream& stream, const Kernel<Params>& kernel, std::size_t n_threads, const Params& params) {
    if (n_threads)
        impl_of(stream).launch(kernel, static_cast<std::uint32_t>(n_threads), &params, sizeof(Params));
}

}  // namespace relidar
