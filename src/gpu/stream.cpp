// SPDX-License-Identifier: Apache-2.0
// Records Vulkan commands and submits them with a timeline semaphore. Measures kernel
// launches with timestamps.
#include "gpu/stream.hpp"

#include <algorithm>
#include <cstring>
#include <exception>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {

Stream::Impl::Impl(Device& d, bool with_timing)
    : owner(&d), device(&d.impl()), timing(with_timing && d.info().timestamps) {
    if (device->compile_only) return;
    VkSemaphoreTypeCreateInfo type{VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO};
    type.semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE;
    VkSemaphoreCreateInfo semaphore{VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO, &type};
    gpu::check(vkCreateSemaphore(device->device, &semaphore, nullptr, &timeline), "vkCreateSemaphore");
    gpu::name_object(device->device, VK_OBJECT_TYPE_SEMAPHORE, timeline, "submissions of a stream");
    const bool measures = d.info().timestamps && device->launch_limit.is_set();
    for (Slot& slot : slots) {
        VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
        pool.queueFamilyIndex = device->queue_family;
        gpu::check(vkCreateCommandPool(device->device, &pool, nullptr, &slot.pool), "vkCreateCommandPool");
        gpu::name_object(device->device, VK_OBJECT_TYPE_COMMAND_POOL, slot.pool, "commands of a stream");
        if (!timing && !measures) continue;
        VkQueryPoolCreateInfo queries{VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO};
        queries.queryType = VK_QUERY_TYPE_TIMESTAMP;
        queries.queryCount = 2 * kMaxLaunches;
        gpu::check(vkCreateQueryPool(device->device, &queries, nullptr, &slot.queries), "vkCreateQueryPool");
        gpu::name_object(device->device, VK_OBJECT_TYPE_QUERY_POOL, slot.queries, "times of launches");
    }
}

Stream::Impl::~Impl() {
    if (device->compile_only) return;
    device->wait_idle();
    if (recording) --device->n_recording;
    for (Slot& slot : slots) {
        if (slot.queries) vkDestroyQueryPool(device->device, slot.queries, nullptr);
        if (slot.pool) vkDestroyCommandPool(device->device, slot.pool, nullptr);
    }
    if (timeline) vkDestroySemaphore(device->device, timeline, nullptr);
}

VkCommandBuffer Stream::Impl::commands() {
    Slot& slot = slots[current];
    if (recording) return slot.commands;
    wait(slot.ticket);
    collect_times(slot);
    slot.block = slot.block_bytes = 0;
    slot.kept.clear();
    gpu::check(vkResetCommandPool(device->device, slot.pool, 0), "vkResetCommandPool");
    if (slot.queries) vkResetQueryPool(device->device, slot.queries, 0, 2 * kMaxLaunches);
    slot.n_buffers = 0;
    begin_buffer(slot);
    recording = true;
    ++device->n_recording;
    return slot.commands;
}

void Stream::Impl::begin_buffer(Slot& slot) {
    if (slot.n_buffers == slot.buffers.size()) {
        VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
        allocate.commandPool = slot.pool;
        allocate.commandBufferCount = 1;
        VkCommandBuffer buffer = VK_NULL_HANDLE;
        gpu::check(vkAllocateCommandBuffers(device->device, &allocate, &buffer), "vkAllocateCommandBuffers");
        gpu::name_object(device->device, VK_OBJECT_TYPE_COMMAND_BUFFER, buffer, "commands of a stream");
        slot.buffers.push_back(buffer);
    }
    slot.commands = slot.buffers[slot.n_buffers++];
    VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    gpu::check(vkBeginCommandBuffer(slot.commands, &begin), "vkBeginCommandBuffer");
    recorded_s = 0.0;
}

void Stream::Impl::submit_part() {
    Slot& slot = slots[current];
    gpu::check(vkEndCommandBuffer(slot.commands), "vkEndCommandBuffer");
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &slot.commands;
    device->submit(info);
    begin_buffer(slot);
}

void Stream::Impl::begin_label(const std::string& name) {
    if (!vkCmdBeginDebugUtilsLabelEXT) return;
    VkDebugUtilsLabelEXT label{VK_STRUCTURE_TYPE_DEBUG_UTILS_LABEL_EXT};
    label.pLabelName = name.c_str();
    vkCmdBeginDebugUtilsLabelEXT(commands(), &label);
}

void Stream::Impl::end_label() {
    if (vkCmdEndDebugUtilsLabelEXT) vkCmdEndDebugUtilsLabelEXT(commands());
}

void Stream::Impl::end_concurrent() {
    if (--n_concurrent > 0 || !owes_barrier) return;
    owes_barrier = false;
    barrier();
}

void Stream::Impl::store_lane_command(const std::string& name, Command command) {
    StreamLane& chosen = lanes[lane];
    if (chosen.empty() || chosen.back().closed) chosen.push_back({name, {}});
    chosen.back().commands.push_back(std::move(command));
    barrier();
}

/// Records the commands of all lanes (concurrent sequences), step by step. Each step has
/// a single pair of timestamps. More timestamps would make its commands wait for each
/// other.
void Stream::Impl::record_concurrent_lanes() {
    std::size_t n_steps = 0;
    for (const StreamLane& one : lanes) n_steps = std::max(n_steps, one.size());
    for (std::size_t k = 0; k < n_steps; ++k) {
        const auto has_step = [k](const StreamLane& one) { return k < one.size(); };
        const std::string& name = std::ranges::find_if(lanes, has_step)->at(k).name;
        begin_timing(name);
        begin_label(name);
        for (const StreamLane& one : lanes)
            if (has_step(one))
                for (const Command& command : one[k].commands) command(commands());
        end_label();
        end_timing();
        record_barrier();
    }
    for (StreamLane& one : lanes) one.clear();
}

void Stream::Impl::barrier() {
    if (n_concurrent > 0) owes_barrier = true;
    else if (!lanes.empty()) lanes[lane].back().closed = true;
    else record_barrier();
}

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
    vkCmdPipelineBarrier(commands(), VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, later, 0, 1, &all, 0, nullptr, 0,
                         nullptr);
}

void Stream::Impl::begin_timing(const std::string& name, gpu::KernelSpeed* speed, std::uint32_t n_groups,
                                bool continues) {
    last_kernel = name;
    VkCommandBuffer buffer = commands();
    Slot& slot = slots[current];
    if (speed && !speed->should_measure(device->launch_limit.piece_s, n_groups)) speed = nullptr;
    timed = slot.queries && (timing || speed) && slot.launches.size() < kMaxLaunches;
    if (!timed) return;
    slot.launches.push_back({name, speed, n_groups, continues});
    vkCmdWriteTimestamp(buffer, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, slot.queries,
                        2 * static_cast<std::uint32_t>(slot.launches.size() - 1));
}

void Stream::Impl::end_timing() {
    Slot& slot = slots[current];
    if (timed)
        vkCmdWriteTimestamp(slot.commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, slot.queries,
                            2 * static_cast<std::uint32_t>(slot.launches.size() - 1) + 1);
}

Stream::Impl::Stored Stream::Impl::store(const void* bytes, std::size_t n_bytes) {
    constexpr std::size_t kAlignment = 64;
    commands();
    Slot& slot = slots[current];
    const std::size_t aligned = (n_bytes + kAlignment - 1) / kAlignment * kAlignment;
    while (slot.block < slot.blocks.size() && slot.block_bytes + aligned > slot.blocks[slot.block]->n_bytes) {
        ++slot.block;
        slot.block_bytes = 0;
    }
    if (slot.block == slot.blocks.size())
        slot.blocks.push_back(std::make_unique<Buffer::Impl>(
            *device, std::max(kBlockBytes, aligned), gpu::MemoryUse::parameters, "kernel parameters"));
    const Buffer::Impl& block = *slot.blocks[slot.block];
    const std::size_t offset = slot.block_bytes;
    slot.block_bytes += aligned;
    std::memcpy(block.mapped + offset, bytes, n_bytes);
    return {block.handle, offset, block.address + offset};
}

void Stream::Impl::write(const Buffer& buffer, const void* bytes, std::size_t n_bytes) {
    if (device->compile_only || n_bytes == 0) return;
    const Stored from = store(bytes, n_bytes);
    record("write",
           [from = from.buffer, to = buffer.impl().handle, region = VkBufferCopy{from.offset, 0, n_bytes}](
               VkCommandBuffer commands) { vkCmdCopyBuffer(commands, from, to, 1, &region); });
}

void Stream::Impl::read_back(const Buffer::Impl& source, const std::shared_ptr<const Buffer::Impl>& target,
                             const VkBufferCopy& region) {
    if (region.size == 0) return;
    record("read back", [this, source = source.handle, target, region](VkCommandBuffer commands) {
        vkCmdCopyBuffer(commands, source, target->handle, 1, &region);
        slots[current].kept.push_back(target);
        host_reads = true;
    });
}

std::uint64_t Stream::Impl::store_parameters(const KernelBase& kernel, const void* bytes,
                                             std::size_t n_bytes) {
    std::vector<std::byte> params(n_bytes);
    std::memcpy(params.data(), bytes, n_bytes);
    for (const std::uint32_t offset : kernel.impl().addresses) {
        std::uint64_t address;
        std::memcpy(&address, params.data() + offset, sizeof(address));
        if (address == 0) std::memcpy(params.data() + offset, &device->nothing->address, sizeof(address));
    }
    return store(params.data(), n_bytes).address;
}

/// Launch of a kernel. Its workgroups form rows and columns, because Vulkan limits their
/// number in one dimension. A launch that would take too long is split into dispatches of
/// consecutive rows.
struct Stream::Impl::Dispatch {
    VkPipeline pipeline;
    std::array<std::uint64_t, 2> pushed;
    std::uint32_t rows, columns, rows_per_piece;

    std::uint32_t count_workgroup_rows_from(std::uint32_t row) const {
        return std::min(rows_per_piece, rows - row);
    }
    void record(VkCommandBuffer commands, VkPipelineLayout layout, std::uint32_t row) const {
        vkCmdBindPipeline(commands, VK_PIPELINE_BIND_POINT_COMPUTE, pipeline);
        vkCmdPushConstants(commands, layout, VK_SHADER_STAGE_COMPUTE_BIT, 0, sizeof(pushed), pushed.data());
        vkCmdDispatchBase(commands, 0, row, 0, columns, count_workgroup_rows_from(row), 1);
    }
};

namespace {

Stream::Impl::Dispatch make_dispatch(VkPipeline pipeline, const std::array<std::uint64_t, 2>& pushed,
                                     std::uint32_t n_groups, std::uint32_t groups_per_piece) {
    // Maximum number of workgroups per dimension that every Vulkan device supports.
    constexpr std::uint32_t kMaxGroups = 65535;
    const std::uint32_t columns =
        std::max(std::min({n_groups, kMaxGroups, groups_per_piece}), (n_groups - 1) / kMaxGroups + 1);
    // All rows have the same number of workgroups, so that few workgroups are
    // superfluous.
    const std::uint32_t rows = (n_groups - 1) / columns + 1, even_columns = (n_groups - 1) / rows + 1;
    // A launch that is short enough, or must not be split, is a single dispatch with all
    // rows.
    const std::uint32_t rows_per_piece =
        groups_per_piece >= n_groups ? rows : std::max(1u, groups_per_piece / even_columns);
    return {pipeline, pushed, rows, even_columns, rows_per_piece};
}

}  // namespace

void Stream::Impl::launch(const KernelBase& kernel, std::uint32_t n_threads, const void* bytes,
                          std::size_t n_bytes) {
    if (device->compile_only)
        throw Error(ExitCode::bug, fmt::format("cannot launch {}: the device was opened only for compilation",
                                               kernel.impl().name));
    const VkPipeline pipeline = kernel.impl().pipeline();
    const std::array<std::uint64_t, 2> pushed{store_parameters(kernel, bytes, n_bytes),
                                              device->nothing->address};
    const std::string& name = kernel.impl().name;
    const std::uint32_t n_groups = (n_threads - 1) / kernel.impl().workgroup_size + 1;
    const gpu::LaunchLimit& limit = device->launch_limit;
    const gpu::KernelSpeed* speed = limit.is_set() ? kernel.impl().speed : nullptr;
    const Dispatch dispatch = make_dispatch(pipeline, pushed, n_groups,
                                            speed ? speed->choose_groups_per_piece(limit.piece_s) : n_groups);
    // Launches in lanes (concurrent sequences) are not split, because their commands are
    // recorded later and in a single submission.
    if (speed && lanes.empty()) return record_dispatch_pieces(kernel.impl(), dispatch);
    record(name, [layout = device->pipeline_layout, dispatch](VkCommandBuffer commands) {
        for (std::uint32_t row = 0; row < dispatch.rows; row += dispatch.rows_per_piece)
            dispatch.record(commands, layout, row);
    });
}

void Stream::Impl::record_dispatch_pieces(const KernelBase::Impl& kernel, const Dispatch& dispatch) {
    const double piece_s = device->launch_limit.piece_s;
    for (std::uint32_t row = 0; row < dispatch.rows; row += dispatch.rows_per_piece) {
        const std::uint32_t n_groups = dispatch.count_workgroup_rows_from(row) * dispatch.columns;
        double expected_s = kernel.speed->estimate_seconds(n_groups);
        // While the speed of a kernel is unknown, each of its dispatches gets a separate
        // submission.
        if (expected_s == 0.0 && n_groups < dispatch.rows * dispatch.columns) expected_s = piece_s;
        commands();
        if (recorded_s > 0.0 && recorded_s + expected_s > piece_s) submit_part();
        begin_timing(kernel.name, kernel.speed, n_groups, row > 0);
        begin_label(kernel.name);
        dispatch.record(commands(), device->pipeline_layout, row);
        end_label();
        end_timing();
        recorded_s += expected_s;
    }
    barrier();
}

void Stream::Impl::wait(std::uint64_t ticket) {
    if (!ticket) return;
    if (ticket == last_ticket) ++device->n_full_waits;
    VkSemaphoreWaitInfo info{VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO};
    info.semaphoreCount = 1;
    info.pSemaphores = &timeline;
    info.pValues = &ticket;
    const VkResult result = vkWaitSemaphores(device->device, &info, ~std::uint64_t(0));
    if (result != VK_SUCCESS)
        gpu::fail(result,
                  fmt::format("waiting for {} failed: the driver returned {} (last recorded kernel: {})",
                              device->info.name, gpu::get_result_name(result), last_kernel));
}

void Stream::Impl::collect_times(Slot& slot) {
    if (slot.launches.empty()) return;
    std::vector<std::uint64_t> stamps(2 * slot.launches.size());
    const VkResult result =
        vkGetQueryPoolResults(device->device, slot.queries, 0, static_cast<std::uint32_t>(stamps.size()),
                              stamps.size() * 8, stamps.data(), 8, VK_QUERY_RESULT_64_BIT);
    double launch_ms = 0.0;  // sum of the pieces of a launch
    for (std::size_t i = 0; result == VK_SUCCESS && i < slot.launches.size(); ++i) {
        const auto& [name, speed, n_groups, continues] = slot.launches[i];
        // The device's counter may have fewer than 64 bits and overflow to 0.
        const std::uint64_t ticks = (stamps[2 * i + 1] - stamps[2 * i]) & device->timestamp_mask;
        const double ms = double(ticks) * device->timestamp_period_ns * 1e-6;
        launch_ms = continues ? launch_ms + ms : ms;
        const bool is_complete = i + 1 == slot.launches.size() || !slot.launches[i + 1].continues;
        if (timing && is_complete) times.add(name, launch_ms);
        if (speed) speed->add(n_groups, 1e-3 * ms);
    }
    slot.launches.clear();
}

Stream::Stream(Device& device, bool timing) : impl_(std::make_unique<Impl>(device, timing)) {}
Stream::~Stream() = default;
Device& Stream::device() const { return *impl_->owner; }
void Stream::wait(std::uint64_t ticket) { impl_->wait(ticket); }

void Stream::fill(const Buffer& buffer, std::uint32_t pattern) {
    if (impl_->device->compile_only) return;
    impl_->record("fill", [to = buffer.impl().handle, pattern](VkCommandBuffer commands) {
        vkCmdFillBuffer(commands, to, 0, VK_WHOLE_SIZE, pattern);
    });
}

void Stream::copy(const Buffer& source, const Buffer& target, std::size_t n_bytes) {
    if (impl_->device->compile_only) return;
    impl_->record("copy", [source = source.impl().handle, target = target.impl().handle,
                           n_bytes](VkCommandBuffer commands) {
        const VkBufferCopy region{0, 0, n_bytes};
        vkCmdCopyBuffer(commands, source, target, 1, &region);
    });
}

Concurrent::Concurrent(Stream& stream) : stream_(stream) { ++stream.impl().n_concurrent; }
Concurrent::~Concurrent() { stream_.impl().end_concurrent(); }

StreamLanes::StreamLanes(Stream& stream, std::size_t count) : stream_(stream) {
    Stream::Impl& s = stream.impl();
    if (count == 0 || !s.lanes.empty() || s.n_concurrent > 0)
        throw Error(ExitCode::bug,
                    "cannot record in lanes: expected at least one lane, no other lanes and no open "
                    "Concurrent scope");
    s.lanes.resize(count);
    s.lane = 0;
}

StreamLanes::~StreamLanes() {
    Stream::Impl& s = stream_.impl();
    // After an exception the commands are dropped, because the arrays that they use may
    // be destroyed.
    if (std::uncaught_exceptions() == 0) s.record_concurrent_lanes();
    s.lanes.clear();
}

void StreamLanes::select_lane(std::size_t lane) {
    Stream::Impl& s = stream_.impl();
    if (lane >= s.lanes.size() || s.n_concurrent > 0)
        throw Error(
            ExitCode::bug,
            fmt::format("cannot choose lane {} of {}: expected the index of a lane and no open Concurrent "
                        "scope",
                        lane, s.lanes.size()));
    s.lane = lane;
}

std::uint64_t Stream::submit() {
    Impl& s = *impl_;
    if (s.device->compile_only) return 0;
    if (s.n_concurrent > 0)
        throw Error(ExitCode::bug, "cannot submit commands: a Concurrent scope is still open");
    s.record_concurrent_lanes();
    VkCommandBuffer commands = s.commands();
    // Marks the end of a frame. RenderDoc and GFXReconstruct need this label to capture a
    // program that has no window.
    if (vkCmdInsertDebugUtilsLabelEXT) {
        VkDebugUtilsLabelEXT frame_end{VK_STRUCTURE_TYPE_DEBUG_UTILS_LABEL_EXT};
        frame_end.pLabelName = "vr-marker,frame_end,type,application";
        vkCmdInsertDebugUtilsLabelEXT(commands, &frame_end);
    }
    gpu::check(vkEndCommandBuffer(commands), "vkEndCommandBuffer");
    const std::uint64_t ticket = s.last_ticket + 1;
    VkTimelineSemaphoreSubmitInfo values{VK_STRUCTURE_TYPE_TIMELINE_SEMAPHORE_SUBMIT_INFO};
    values.signalSemaphoreValueCount = 1;
    values.pSignalSemaphoreValues = &ticket;
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO, &values};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &commands;
    info.signalSemaphoreCount = 1;
    info.pSignalSemaphores = &s.timeline;
    s.device->submit(info);
    s.recording = false;
    --s.device->n_recording;
    s.recorded_s = 0.0;
    s.last_ticket = s.slots[s.current].ticket = ticket;
    s.current = (s.current + 1) % Impl::kSlots;
    return ticket;
}

const KernelTimes& Stream::times() const {
    for (Impl::Slot& slot : impl_->slots) {
        const bool open = impl_->recording && &slot == &impl_->slots[impl_->current];
        if (open || !slot.ticket) continue;
        impl_->wait(slot.ticket);
        impl_->collect_times(slot);
    }
    return impl_->times;
}

void Stream::reset_times() {
    times();
    impl_->times = {};
}

void KernelTimes::add(const std::string& kernel, double ms) {
    std::vector<double>& last = milliseconds[kernel];
    if (std::ssize(last) >= kLast) last.erase(last.begin());
    last.push_back(ms);
    Total& total = totals[kernel];
    total.launches += 1.0;
    total.ms += ms;
}

void KernelTimes::add(const KernelTimes& later) {
    for (const auto& [kernel, ms] : later.milliseconds) {
        std::vector<double>& last = milliseconds[kernel];
        last.insert(last.end(), ms.begin(), ms.end());
        if (std::ssize(last) > kLast) last.erase(last.begin(), last.end() - kLast);
    }
    for (const auto& [kernel, more] : later.totals) {
        totals[kernel].launches += more.launches;
        totals[kernel].ms += more.ms;
    }
}

}  // namespace relidar
