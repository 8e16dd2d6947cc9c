// SPDX-License-Identifier: Apache-2.0
#include "gpu/stream.hpp"

#include <algorithm>
#include <cstring>
#include <exception>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {

/// Creates the timeline semaphore, and a command pool for each slot. Creates query pools
/// for timestamps if somebody needs the times of launches.
Stream::Impl::Impl(Device& d, bool with_timing)
    : owner(&d), device(&d.impl()), timing(with_timing && d.info().timestamps) {
    if (device->compile_only) return;
    VkSemaphoreTypeCreateInfo type{VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO};
    type.semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE;
    VkSemaphoreCreateInfo semaphore{VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO, &type};
    gpu::vk_check(vkCreateSemaphore(device->device, &semaphore, nullptr, &timeline), "vkCreateSemaphore");
    gpu::set_object_name(device->device, VK_OBJECT_TYPE_SEMAPHORE, timeline, "submissions of a stream");
    // A device with a time limit also needs the times, to estimate later launches.
    const bool measures = d.info().timestamps && device->launch_limit.has_limit();
    for (SubmissionSlot& slot : slots) {
        VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
        pool.queueFamilyIndex = device->queue_family;
        gpu::vk_check(vkCreateCommandPool(device->device, &pool, nullptr, &slot.pool), "vkCreateCommandPool");
        gpu::set_object_name(device->device, VK_OBJECT_TYPE_COMMAND_POOL, slot.pool, "commands of a stream");
        if (!timing && !measures) continue;
        VkQueryPoolCreateInfo queries{VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
        queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
        // start and end of each launch
        queries.queryCount = 2 * kMaxLaunches;
        gpu::vk_check(vkCreateQueryPool(device->device, &queries, nullptr, &slot.queries),
                      "vkCreateQueryPool");
        gpu::set_object_name(device->device, VK_OBJECT_TYPE_QUERY_POOL, slot.queries, "times of launches");
    }
}

/// Waits until the device has finished all submissions, and destroys the Vulkan objects.
Stream::Impl::~Impl() {
    // The driver's threads do not exist in a forked process, so a wait would not end.
    if (device->compile_only || device->is_forked()) return;
    device->wait_idle();
    if (recording) --device->n_recording;
    for (SubmissionSlot& slot : slots) {
        if (slot.queries) vkDestroyQueryPool(device->device, slot.queries, nullptr);
        if (slot.pool) vkDestroyCommandPool(device->device, slot.pool, nullptr);
    }
    if (timeline) vkDestroySemaphore(device->device, timeline, nullptr);
}

/// Returns the command buffer of the current recording. Starts a recording if there is
/// none, and first waits until the device has finished the previous submission of this
/// slot.
VkCommandBuffer Stream::Impl::open_commands() {
    SubmissionSlot& slot = slots[current];
    if (recording) return slot.commands;
    wait_for(slot.ticket);
    collect_times(slot);
    // All memory and all commands of the finished submission can be used again.
    slot.block = slot.block_bytes = 0;
    slot.retained_buffers.clear();
    slot.n_buffers = 0;
    gpu::vk_check(vkResetCommandPool(device->device, slot.pool, 0), "vkResetCommandPool");
    if (slot.queries) vkResetQueryPool(device->device, slot.queries, 0, 2 * kMaxLaunches);
    begin_commands(slot);
    recording = true;
    ++device->n_recording;
    return slot.commands;
}

/// Begins another command buffer of a slot. Allocates one if all buffers are in use.
void Stream::Impl::begin_commands(SubmissionSlot& slot) {
    if (slot.n_buffers == slot.buffers.size()) {
        VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
        allocate.commandPool = slot.pool;
        allocate.commandBufferCount = 1;
        VkCommandBuffer buffer = VK_NULL_HANDLE;
        gpu::vk_check(vkAllocateCommandBuffers(device->device, &allocate, &buffer),
                      "vkAllocateCommandBuffers");
        gpu::set_object_name(device->device, VK_OBJECT_TYPE_COMMAND_BUFFER, buffer, "commands of a stream");
        slot.buffers.push_back(buffer);
    }
    slot.commands = slot.buffers[slot.n_buffers++];
    VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    gpu::vk_check(vkBeginCommandBuffer(slot.commands, &begin), "vkBeginCommandBuffer");
    recorded_s = 0.0;  // expected duration of the commands in this buffer
}

/// Submits the commands recorded so far without a ticket, so that a slow launch is split
/// over several submissions. Recording continues in a new command buffer.
void Stream::Impl::submit() {
    SubmissionSlot& slot = slots[current];
    gpu::vk_check(vkEndCommandBuffer(slot.commands), "vkEndCommandBuffer");
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &slot.commands;
    device->submit_to_queue(info);
    begin_commands(slot);
}

void Stream::Impl::begin_debug_label(const std::string& label_text) {
    if (!vkCmdBeginDebugUtilsLabelEXT) return;
    VkDebugUtilsLabelEXT label{VK_STRUCTURE_TYPE_DEBUG_UTILS_LABEL_EXT};
    label.pLabelName = label_text.c_str();
    vkCmdBeginDebugUtilsLabelEXT(open_commands(), &label);
}

void Stream::Impl::end_debug_label() {
    if (vkCmdEndDebugUtilsLabelEXT) vkCmdEndDebugUtilsLabelEXT(open_commands());
}

void Stream::Impl::end_concurrent() {
    if (--n_concurrent > 0 || !owes_barrier) return;
    owes_barrier = false;
    barrier_or_defer();
}

void Stream::Impl::add_command(const std::string& name, VulkanCommandRecorder command) {
    CommandSequence& chosen = lanes[lane];
    if (chosen.empty() || chosen.back().closed) chosen.push_back({name, {}});
    chosen.back().commands.push_back(std::move(command));
    barrier_or_defer();
}

/// Records the stored commands of all lanes (sequences that the device may run
/// concurrently), step by step: step k of every lane, then one barrier. Each step has a
/// single pair of timestamps, because more timestamps would serialise its commands.
void Stream::Impl::merge_lanes() {
    std::size_t n_steps = 0;
    for (const CommandSequence& steps : lanes) n_steps = std::max(n_steps, steps.size());
    for (std::size_t k = 0; k < n_steps; ++k) {
        // The step has the name of the first lane that is so long.
        const auto has_step = [k](const CommandSequence& steps) { return k < steps.size(); };
        const std::string& name = std::ranges::find_if(lanes, has_step)->at(k).name;
        begin_timing(name);
        begin_debug_label(name);
        for (const CommandSequence& steps : lanes)
            if (has_step(steps))
                for (const VulkanCommandRecorder& command : steps[k].commands) command(open_commands());
        end_debug_label();
        end_timing();
        record_barrier();
    }
    for (CommandSequence& steps : lanes) steps.clear();
}

void Stream::Impl::barrier_or_defer() {
    if (n_concurrent > 0) owes_barrier = true;
    else if (!lanes.empty()) lanes[lane].back().closed = true;
    else record_barrier();
}

/// Records a full memory barrier, so that all later commands see all earlier writes. If
/// the host reads the results, the barrier also makes them visible to the host.
void Stream::Impl::record_barrier() {
    VkMemoryBarrier all{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
    all.srcAccessMask = VK_ACCESS_MEMORY_WRITE_BIT;
    all.dstAccessMask = VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
    VkPipelineStageFlags later = VK_PIPELINE_STAGE_ALL_COMMANDS_BIT;
    if (host_reads) {
        all.dstAccessMask |= VK_ACCESS_HOST_READ_BIT;
        later |= VK_PIPELINE_STAGE_HOST_BIT;
        host_reads = false;
    }
    vkCmdPipelineBarrier(open_commands(), VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, later, 0, 1, &all, 0, nullptr,
                         0, nullptr);
}

/// Writes the first timestamp of a command. Does so only if the user or the speed
/// estimate of the kernel needs the time, and the slot has free queries.
/// @param continues true if the command is not the first piece of its launch
void Stream::Impl::begin_timing(const std::string& name, gpu::KernelSpeed* speed, std::uint32_t n_workgroups,
                                bool continues) {
    last_kernel = name;
    VkCommandBuffer buffer = open_commands();
    SubmissionSlot& slot = slots[current];
    if (speed && !speed->should_measure(device->launch_limit.piece_s, n_workgroups)) speed = nullptr;
    const bool has_free_query = slot.queries && slot.launches.size() < kMaxLaunches;
    timed = has_free_query && (timing || speed);
    if (!timed) return;
    slot.launches.push_back({name, speed, n_workgroups, continues});
    vkCmdWriteTimestamp(buffer, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, slot.queries,
                        2 * static_cast<std::uint32_t>(slot.launches.size() - 1));
}

void Stream::Impl::end_timing() {
    SubmissionSlot& slot = slots[current];
    if (timed)
        vkCmdWriteTimestamp(slot.commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, slot.queries,
                            2 * static_cast<std::uint32_t>(slot.launches.size() - 1) + 1);
}

/// Copies bytes from the host into memory that kernels of the current submission can
/// read. The memory is reused after this submission is finished.
Stream::Impl::StagedValue Stream::Impl::stage_bytes(const void* host_bytes, std::size_t n_bytes) {
    constexpr std::size_t kStagingAlignment = 64;
    open_commands();
    SubmissionSlot& slot = slots[current];
    const std::size_t aligned = (n_bytes + kStagingAlignment - 1) / kStagingAlignment * kStagingAlignment;
    // Skips blocks whose remaining space is too small for this value.
    while (slot.block < slot.blocks.size() && slot.block_bytes + aligned > slot.blocks[slot.block]->n_bytes) {
        ++slot.block;
        slot.block_bytes = 0;
    }
    if (slot.block == slot.blocks.size())
        slot.blocks.push_back(std::make_unique<Buffer::Impl>(
            *device, std::max(kBlockBytes, aligned), gpu::BufferPurpose::parameters, "kernel parameters"));
    const Buffer::Impl& block = *slot.blocks[slot.block];
    const std::size_t offset = slot.block_bytes;
    slot.block_bytes += aligned;
    device->staged_bytes += n_bytes;
    if (n_bytes != 0) std::memcpy(block.mapped + offset, host_bytes, n_bytes);
    return {block.handle, offset, block.address + offset};
}

void Stream::Impl::record_write(const Buffer& buffer, const void* host_bytes, std::size_t n_bytes) {
    if (device->compile_only || n_bytes == 0) return;
    const StagedValue staged = stage_bytes(host_bytes, n_bytes);
    const VkBufferCopy region{.srcOffset = staged.offset, .dstOffset = 0, .size = n_bytes};
    record_command("write",
                   [from = staged.buffer, to = buffer.impl().handle, region](VkCommandBuffer commands) {
                       vkCmdCopyBuffer(commands, from, to, 1, &region);
                   });
}

/// Records a copy to host memory. The slot keeps the target alive until the device has
/// finished the submission.
void Stream::Impl::record_copy(const Buffer::Impl& source, const std::shared_ptr<const Buffer::Impl>& target,
                               const VkBufferCopy& region) {
    if (region.size == 0) return;
    ++device->n_downloads;
    device->download_bytes += region.size;
    record_command("read back", [this, source = source.handle, target, region](VkCommandBuffer commands) {
        vkCmdCopyBuffer(commands, source, target->handle, 1, &region);
        slots[current].retained_buffers.push_back(target);
        host_reads = true;
    });
}

/// Copies the parameter struct of a launch to memory that the kernel can read. Replaces
/// each address 0 by the address of a buffer with zeros, so that kernels can load from
/// arrays that a launch leaves out.
std::uint64_t Stream::Impl::stage_parameters(const KernelBase& kernel, const void* parameter_struct,
                                             std::size_t n_bytes) {
    std::vector<std::byte> params(n_bytes);
    std::memcpy(params.data(), parameter_struct, n_bytes);
    for (const std::uint32_t offset : kernel.impl().addresses) {
        std::uint64_t address;
        std::memcpy(&address, params.data() + offset, sizeof(address));
        if (address == 0) std::memcpy(params.data() + offset, &device->nothing->address, sizeof(address));
    }
    return stage_bytes(params.data(), n_bytes).address;
}

/// A launch as rows of workgroups, because Vulkan limits the number in one dimension. A
/// slow launch is split into pieces: dispatches of consecutive rows.
struct Stream::Impl::Dispatch {
    VkPipeline pipeline;
    std::array<std::uint64_t, 2> pushed;
    std::uint32_t rows, columns, rows_per_piece;

    std::uint32_t rows_of_piece(std::uint32_t first_row) const {
        return std::min(rows_per_piece, rows - first_row);
    }
    void record_piece(VkCommandBuffer commands, VkPipelineLayout layout, std::uint32_t first_row) const {
        vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline);
        vkCmdPushConstants(commands, layout, VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof(pushed), pushed.data());
        vkCmdDispatchBase(commands, 0, first_row, 0, columns, rows_of_piece(first_row), 1);
    }
};

namespace {

/// Arranges the workgroups of a launch in rows, and divides the rows into pieces.
/// @param max_groups number of workgroups that one piece may have, from the time limit
Stream::Impl::Dispatch split_launch(VkPipeline pipeline, const std::array<std::uint64_t, 2>& push,
                                    std::uint32_t n_workgroups, std::uint32_t max_groups) {
    // Number of rows and of columns that every Vulkan device supports.
    constexpr std::uint32_t kMaxDimension = 65535;
    const auto divide_up = [](std::uint32_t a, std::uint32_t b) { return (a - 1) / b + 1; };
    // A row is as long as a piece may be, but not so short that there are too many rows.
    const std::uint32_t min_columns = divide_up(n_workgroups, kMaxDimension);
    const std::uint32_t max_columns =
        std::clamp(std::min(n_workgroups, max_groups), min_columns, kMaxDimension);
    const std::uint32_t rows = divide_up(n_workgroups, max_columns);
    // Equal rows, so that the last row has few superfluous workgroups.
    const std::uint32_t columns = divide_up(n_workgroups, rows);
    const bool is_one_piece = max_groups >= n_workgroups;
    const std::uint32_t rows_per_piece = is_one_piece ? rows : std::max(1u, max_groups / columns);
    return {pipeline, push, rows, columns, rows_per_piece};
}

}  // namespace

/// Records one launch of a kernel. On a GPU, a launch that would exceed the time limit
/// becomes several dispatches, which may be in separate submissions.
void Stream::Impl::record_launch(const KernelBase& kernel, std::uint32_t n_threads, const void* params,
                                 std::size_t n_bytes) {
    if (device->compile_only)
        throw Error(ExitCode::bug,
                    fmt::format("cannot run kernel {}: the device was opened only to compile kernels",
                                kernel.impl().name));
    const VkPipeline pipeline = kernel.impl().wait_for_pipeline();
    // Push constants: addresses of the parameters, and of zeros for missing arrays.
    const std::array<std::uint64_t, 2> pushed{stage_parameters(kernel, params, n_bytes),
                                              device->nothing->address};
    const std::uint32_t n_groups = (n_threads - 1) / kernel.impl().workgroup_size + 1;
    // The measured speed of the kernel, or null if its launches are not limited.
    const gpu::LaunchTimeLimit& limit = device->launch_limit;
    const gpu::KernelSpeed* speed = limit.has_limit() ? kernel.impl().speed : nullptr;
    const std::uint32_t max_groups = speed ? speed->workgroups_for(limit.piece_s) : n_groups;
    const Dispatch dispatch = split_launch(pipeline, pushed, n_groups, max_groups);
    // Commands in lanes are stored now and recorded later, in a single submission.
    if (speed && lanes.empty()) return submit_pieces(kernel.impl(), dispatch);
    record_command(kernel.impl().name,
                   [layout = device->pipeline_layout, dispatch](VkCommandBuffer commands) {
                       for (std::uint32_t row = 0; row < dispatch.rows; row += dispatch.rows_per_piece)
                           dispatch.record_piece(commands, layout, row);
                   });
}

/// Records the dispatches (pieces) of a launch. Starts a new submission whenever the
/// expected duration of the recorded commands would exceed the time limit.
void Stream::Impl::submit_pieces(const KernelBase::Impl& kernel, const Dispatch& dispatch) {
    const double limit_s = device->launch_limit.piece_s;
    for (std::uint32_t row = 0; row < dispatch.rows; row += dispatch.rows_per_piece) {
        const std::uint32_t n_groups = dispatch.rows_of_piece(row) * dispatch.columns;
        const bool is_split = n_groups < dispatch.rows * dispatch.columns;
        double expected_s = kernel.speed->estimate_s(n_groups);  // 0: not measured yet
        // Each piece of a split launch then gets a separate submission.
        if (expected_s == 0.0 && is_split) expected_s = limit_s;
        open_commands();
        if (recorded_s > 0.0 && recorded_s + expected_s > limit_s) submit();
        begin_timing(kernel.name, kernel.speed, n_groups, row > 0);
        begin_debug_label(kernel.name);
        dispatch.record_piece(open_commands(), device->pipeline_layout, row);
        end_debug_label();
        end_timing();
        recorded_s += expected_s;
    }
    barrier_or_defer();
}

/// Waits until the submission with this ticket is finished. Ticket 0 means that nothing
/// was submitted. The error names the last recorded kernel, which probably caused it.
void Stream::Impl::wait_for(std::uint64_t ticket) {
    if (!ticket) return;
    device->check_process();
    if (ticket == last_ticket) ++device->n_full_waits;
    VkSemaphoreWaitInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO};
    info.semaphoreCount = 1;
    info.pSemaphores = &timeline;
    info.pValues = &ticket;
    const VkResult result = vkWaitSemaphores(device->device, &info, ~std::uint64_t(0));
    if (result != VK_SUCCESS)
        gpu::vk_fail(result,
                     fmt::format("waiting for {} failed: the driver returned {} (last recorded kernel: {})",
                                 device->info.name, gpu::vk_result_name(result), last_kernel));
}

/// Reads the timestamps of a finished submission. Adds the duration of each launch to the
/// kernel times, if the user needs them, and that of each piece of a launch to the speed
/// estimates that limit the size of later dispatches.
void Stream::Impl::collect_times(SubmissionSlot& slot) {
    if (slot.launches.empty()) return;
    std::vector<std::uint64_t> stamps(2 * slot.launches.size());
    constexpr VkDeviceSize kStampBytes = sizeof(std::uint64_t);
    const VkResult result = vkGetQueryPoolResults(
        device->device, slot.queries, 0, static_cast<std::uint32_t>(stamps.size()),
        stamps.size() * kStampBytes, stamps.data(), kStampBytes, VK_QUERY_RESULT_64_BIT);
    const std::vector<SubmissionSlot::TimedCommands> pieces = std::exchange(slot.launches, {});
    if (result != VK_SUCCESS) return;
    double launch_ms = 0.0;  // sum of the pieces of a launch so far
    for (std::size_t i = 0; i < pieces.size(); ++i) {
        // The device's counter may have fewer than 64 bits and overflow to 0.
        const std::uint64_t ticks = (stamps[2 * i + 1] - stamps[2 * i]) & device->timestamp_mask;
        const double piece_ms = double(ticks) * device->timestamp_period_ns * 1e-6;
        launch_ms = pieces[i].continues ? launch_ms + piece_ms : piece_ms;
        const bool is_last_piece = i + 1 == pieces.size() || !pieces[i + 1].continues;
        if (timing && is_last_piece) times.add_launch_time(pieces[i].name, launch_ms);
        if (pieces[i].speed) pieces[i].speed->add_dispatch(pieces[i].n_groups, 1e-3 * piece_ms);
    }
}

Stream::Stream(Device& device, bool timing) : impl_(std::make_unique<Impl>(device, timing)) {}
Stream::~Stream() = default;
Device& Stream::device() const { return *impl_->owner; }
void Stream::wait_for(std::uint64_t ticket) { impl_->wait_for(ticket); }

void Stream::fill(const Buffer& buffer, std::uint32_t pattern) {
    if (impl_->device->compile_only) return;
    impl_->record_command("fill", [to = buffer.impl().handle, pattern](VkCommandBuffer commands) {
        vkCmdFillBuffer(commands, to, 0, VK_WHOLE_SIZE, pattern);
    });
}

void Stream::copy(const Buffer& source, const Buffer& target, std::size_t n_bytes) {
    if (impl_->device->compile_only) return;
    impl_->record_command("copy", [source = source.impl().handle, target = target.impl().handle,
                                   n_bytes](VkCommandBuffer commands) {
        const VkBufferCopy region{0, 0, n_bytes};
        vkCmdCopyBuffer(commands, source, target, 1, &region);
    });
}

void record_launch(Stream& stream, const KernelBase& kernel, std::uint32_t n_threads, const void* params,
                   std::size_t params_bytes) {
    stream.impl().record_launch(kernel, n_threads, params, params_bytes);
}

ConcurrentLaunchScope::ConcurrentLaunchScope(Stream& stream) : stream_(stream) {
    ++stream.impl().n_concurrent;
}

// Records the barrier that the launches of the scope have left out.
ConcurrentLaunchScope::~ConcurrentLaunchScope() { stream_.impl().end_concurrent(); }

/// Opens `count` lanes: sequences of commands that the device may run concurrently. Until
/// the scope ends, commands are stored, first in lane 0.
ConcurrentSequenceScope::ConcurrentSequenceScope(Stream& stream, std::size_t count) : stream_(stream) {
    Stream::Impl& s = stream.impl();
    if (count == 0 || !s.lanes.empty() || s.n_concurrent > 0)
        throw Error(
            ExitCode::bug,
            fmt::format("cannot open {} lanes: expected at least one, and no open scope on the stream",
                        count));
    s.lanes.resize(count);
    s.lane = 0;
}

ConcurrentSequenceScope::~ConcurrentSequenceScope() {
    if (stream_.impl().device->is_forked()) return;
    Stream::Impl& s = stream_.impl();
    // Drops the commands after an exception, because their arrays may be destroyed.
    if (std::uncaught_exceptions() == 0) s.merge_lanes();
    s.lanes.clear();
}

void ConcurrentSequenceScope::select_lane(std::size_t sequence_index) {
    Stream::Impl& s = stream_.impl();
    if (sequence_index >= s.lanes.size() || s.n_concurrent > 0)
        throw Error(ExitCode::bug,
                    fmt::format("cannot select lane {} of {}, or a ConcurrentLaunchScope is open",
                                sequence_index, s.lanes.size()));
    s.lane = sequence_index;
}

/// Submits all recorded commands and returns the ticket of the submission. The device
/// signals this number on the timeline semaphore. The next recording uses the next slot.
std::uint64_t Stream::submit_commands() {
    Impl& s = *impl_;
    if (s.device->compile_only) return 0;
    if (s.n_concurrent > 0)
        throw Error(ExitCode::bug, "cannot submit commands: a ConcurrentLaunchScope is still open");
    s.merge_lanes();
    VkCommandBuffer commands = s.open_commands();
    // RenderDoc and GFXReconstruct need this label to capture a program without a window.
    if (vkCmdInsertDebugUtilsLabelEXT) {
        VkDebugUtilsLabelEXT frame_end{VK_STRUCTURE_TYPE_DEBUG_UTILS_LABEL_EXT};
        frame_end.pLabelName = "vr-marker,frame_end,type,application";
        vkCmdInsertDebugUtilsLabelEXT(commands, &frame_end);
    }
    gpu::vk_check(vkEndCommandBuffer(commands), "vkEndCommandBuffer");
    const std::uint64_t ticket = s.last_ticket + 1;
    VkTimelineSemaphoreSubmitInfo values{VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO};
    values.signalSemaphoreValueCount = 1;
    values.pSignalSemaphoreValues = &ticket;
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO, &values};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &commands;
    info.signalSemaphoreCount = 1;
    info.pSignalSemaphores = &s.timeline;
    s.device->submit_to_queue(info);
    s.recording = false;
    --s.device->n_recording;
    s.recorded_s = 0.0;
    s.last_ticket = s.slots[s.current].ticket = ticket;
    s.current = (s.current + 1) % Impl::kMaxPending;
    return ticket;
}

/// Returns the measured times of all submitted launches. Waits for them, but skips the
/// slot that is being recorded, because its queries have no results yet.
const KernelTimes& Stream::times() const {
    for (Impl::SubmissionSlot& slot : impl_->slots) {
        const bool open = impl_->recording && &slot == &impl_->slots[impl_->current];
        if (open || !slot.ticket) continue;
        impl_->wait_for(slot.ticket);
        impl_->collect_times(slot);
    }
    return impl_->times;
}

void Stream::reset_times() {
    times();
    impl_->times = {};
}

void KernelTimes::add_launch_time(const std::string& kernel_name, double duration_ms) {
    std::vector<double>& last = milliseconds[kernel_name];
    if (std::ssize(last) >= kMaxTimes) last.erase(last.begin());
    last.push_back(duration_ms);
    LaunchTotals& total = totals[kernel_name];
    total.launches += 1.0;
    total.ms += duration_ms;
}

void KernelTimes::add_times(const KernelTimes& later_times) {
    // Keeps only the last kMaxTimes times of each kernel.
    for (const auto& [kernel, ms] : later_times.milliseconds) {
        std::vector<double>& last = milliseconds[kernel];
        last.insert(last.end(), ms.begin(), ms.end());
        if (std::ssize(last) > kMaxTimes) last.erase(last.begin(), last.end() - kMaxTimes);
    }
    for (const auto& [kernel, more] : later_times.totals) {
        totals[kernel].launches += more.launches;
        totals[kernel].ms += more.ms;
    }
}

}  // namespace relidar
