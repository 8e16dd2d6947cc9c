// SPDX-License-Identifier: Apache-2.0
// Records and submits commands. run() copies the parameters of a kernel to memory that
// host and device share. It passes their address to the kernel and records a full barrier
// after the launch.
//
// The host continues while the device works. A slot (command buffer and its memory) is
// reused only after the device has finished its submission.
#pragma once

#include <relidar/gpu/out_of_memory.hpp>

#include "gpu/buffer.hpp"
#include "gpu/kernel.hpp"

namespace relidar {

struct KernelBase::Impl {
    Device::Impl* device = nullptr;
    std::string module;  ///< Name of the SPIR-V module.
    std::string name;    ///< Name of the kernel without its variant.
    std::span<const std::uint32_t> words;
    /// Contains `words` if the library does not contain the module. Shared with the
    /// thread that compiles the pipeline.
    std::shared_ptr<const std::vector<std::uint32_t>> loaded_words;
    std::vector<SpecialisationConstant> constants;
    SubgroupRequirement subgroups = SubgroupRequirement::any;
    std::uint32_t workgroup_size = 0;  ///< Number of threads per workgroup.
    gpu::KernelSpeed* speed = nullptr;
    std::vector<std::uint32_t> addresses = {};

    VkPipeline wait_for_pipeline();

private:
    friend class KernelBase;
    std::shared_future<gpu::CompiledPipeline> made_;
    VkPipeline pipeline_ = VK_NULL_HANDLE;
};

struct Stream::Impl {
    static constexpr std::size_t kMaxPending = 3;  ///< Maximum number of pending submissions.
    static constexpr std::size_t kBlockBytes = 1 << 16;
    static constexpr std::uint32_t kMaxLaunches = 256;

    struct SubmissionSlot {
        VkCommandPool pool = VK_NULL_HANDLE;
        VkCommandBuffer commands = VK_NULL_HANDLE;
        std::vector<VkCommandBuffer> buffers;
        std::size_t n_buffers = 0;  ///< Number of command buffers of the current recording.
        VkQueryPool queries = VK_NULL_HANDLE;
        struct TimedCommands {
            std::string name;
            gpu::KernelSpeed* speed;
            std::uint32_t n_groups;  ///< Number of workgroups.
            bool continues;
        };
        std::vector<TimedCommands> launches;
        /// For values from the host. Their number grows until the largest submission
        /// fits.
        std::vector<std::unique_ptr<Buffer::Impl>> blocks;
        /// Where the host writes its next value: index in `blocks`, offset in bytes.
        std::size_t block = 0, block_bytes = 0;
        std::vector<std::shared_ptr<const Buffer::Impl>> retained_buffers;
        std::uint64_t ticket = 0;  ///< Number of the submission. 0 if nothing was submitted.
    };

    using VulkanCommandRecorder = std::function<void(VkCommandBuffer)>;
    struct BarrierStep {
        std::string name;  ///< Name of the first command of the step.
        std::vector<VulkanCommandRecorder> commands;
        bool closed = false;
    };
    using CommandSequence = std::vector<BarrierStep>;

    Device* owner = nullptr;
    Device::Impl* device = nullptr;
    bool timing = false;
    std::array<SubmissionSlot, kMaxPending> slots;
    std::size_t current = 0;
    bool recording = false;  ///< True if commands were recorded but not submitted yet.
    int n_concurrent = 0;    ///< Number of open ConcurrentLaunchScope objects.
    /// A barrier must follow at the end of the open ConcurrentLaunchScope.
    bool owes_barrier = false;
    std::vector<CommandSequence> lanes = {};
    std::size_t lane = 0;  ///< Index of the lane that receives new commands.
    bool timed = false;    ///< True if timestamps measure the launch that is currently recorded.
    bool host_reads = false;
    VkSemaphore timeline = VK_NULL_HANDLE;
    std::uint64_t last_ticket = 0;
    std::string last_kernel = "none";
    double recorded_s = 0.0;
    KernelTimes times;

    Impl(Device& device, bool timing);
    ~Impl();

    VkCommandBuffer open_commands();
    /// With timestamps and a barrier. In a ConcurrentSequenceScope, stored for later.
    template <class Recorded>
    void record_command(const std::string& name, Recorded command) {
        if (!lanes.empty()) return add_command(name, std::move(command));
        begin_timing(name);
        begin_debug_label(name);
        command(open_commands());
        end_debug_label();
        end_timing();
        barrier_or_defer();
    }
    void end_concurrent();
    /// Step n of a lane may run concurrently with step n of the other lanes.
    void merge_lanes();
    struct StagedValue {
        VkBuffer buffer;
        std::size_t offset;
        std::uint64_t address;
    };
    StagedValue stage_bytes(const void* host_bytes, std::size_t n_bytes);
    template <class T>
    Address<T> stage_values(const std::vector<T>& host_values) {
        return Address<T>(stage_bytes(host_values.data(), host_values.size() * sizeof(T)).address);
    }
    void record_write(const Buffer& buffer, const void* host_bytes, std::size_t n_bytes);
    void record_copy(const Buffer::Impl& source, const std::shared_ptr<const Buffer::Impl>& target,
                     const VkBufferCopy& region);
    void record_launch(const KernelBase& kernel, std::uint32_t n_threads, const void* params,
                       std::size_t n_bytes);
    void wait_for(std::uint64_t ticket);
    void collect_times(SubmissionSlot& slot);
    struct Dispatch;

private:
    /// Each address 0 in the struct becomes the address of a buffer with zeros.
    /// @return device address of the stored struct
    std::uint64_t stage_parameters(const KernelBase& kernel, const void* params, std::size_t n_bytes);
    void add_command(const std::string& name, VulkanCommandRecorder command);
    /// In a ConcurrentLaunchScope, only the end of the scope records a barrier.
    void barrier_or_defer();
    void record_barrier();
    /// @param continues true if the command continues a launch that was split
    void begin_timing(const std::string& name, gpu::KernelSpeed* speed = nullptr,
                      std::uint32_t n_workgroups = 0, bool continues = false);
    void end_timing();
    void begin_debug_label(const std::string& label_text);
    void end_debug_label();
    void submit_pieces(const KernelBase::Impl& kernel, const Dispatch& dispatch);
    void begin_commands(SubmissionSlot& slot);
    /// The submission continues in a new command buffer.
    void submit();
};

/// Reserves memory for `n_needed` elements of an array that grows repeatedly. If
/// possible, reserves an eighth more, so that few calls copy the array.
/// @param reserve called with a number of elements
template <class Reserve>
void reserve_spare(std::size_t n_needed, const Reserve& reserve) {
    try {
        reserve(n_needed + n_needed / 8 + 8);
    } catch (const OutOfDeviceMemory&) {
        reserve(n_needed);
    }
}

}  // namespace relidar
