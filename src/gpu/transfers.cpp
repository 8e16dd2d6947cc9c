// SPDX-License-Identifier: Apache-2.0
// Copies data between host and device through staging memory, at most 32 MiB at a time.
#include "gpu/transfers.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

namespace relidar::gpu {

namespace {

// Minimum and maximum size of the staging memory in bytes.
constexpr std::size_t kSmallest = std::size_t(64) << 10, kLargest = std::size_t(32) << 20;

}  // namespace

void Transfers::make_commands() {
    VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    pool.queueFamilyIndex = device_.queue_family;
    check(vkCreateCommandPool(device_.device, &pool, nullptr, &pool_), "vkCreateCommandPool");
    VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
    allocate.commandPool = pool_;
    allocate.commandBufferCount = 1;
    check(vkAllocateCommandBuffers(device_.device, &allocate, &commands_), "vkAllocateCommandBuffers");
    name_object(device_.device, VK_OBJECT_TYPE_COMMAND_POOL, pool_, "copies");
    name_object(device_.device, VK_OBJECT_TYPE_COMMAND_BUFFER, commands_, "copies");
    const VkFenceCreateInfo fence{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
    check(vkCreateFence(device_.device, &fence, nullptr, &done_), "vkCreateFence");
    name_object(device_.device, VK_OBJECT_TYPE_FENCE, done_, "copy is done");
}

Transfers::~Transfers() {
    vkDestroyFence(device_.device, done_, nullptr);
    vkDestroyCommandPool(device_.device, pool_, nullptr);
}

Buffer::Impl& Transfers::get_staging_buffer(std::unique_ptr<Buffer::Impl>& buffer, MemoryUse use,
                                            std::size_t n_bytes) {
    const std::size_t staging_bytes = std::clamp(std::bit_ceil(n_bytes), kSmallest, kLargest);
    if (!buffer || buffer->n_bytes < staging_bytes) {
        buffer.reset();
        buffer = std::make_unique<Buffer::Impl>(device_, staging_bytes, use, "staging");
    }
    return *buffer;
}

void Transfers::upload(const Buffer::Impl& target, const void* data, std::size_t n_bytes,
                       std::size_t offset_bytes) {
    const std::lock_guard lock(mutex_);
    const Buffer::Impl& from = get_staging_buffer(upload_, MemoryUse::upload, n_bytes);
    for (std::size_t done = 0; done < n_bytes; done += kLargest) {
        const std::size_t n = std::min(kLargest, n_bytes - done);
        std::memcpy(from.mapped, static_cast<const std::byte*>(data) + done, n);
        copy_and_wait(from.handle, target.handle, {0, offset_bytes + done, n});
    }
}

void Transfers::download(const Buffer::Impl& source, void* data, std::size_t n_bytes,
                         std::size_t offset_bytes) {
    const std::lock_guard lock(mutex_);
    const Buffer::Impl& to = get_staging_buffer(download_, MemoryUse::readback, n_bytes);
    for (std::size_t done = 0; done < n_bytes; done += kLargest) {
        const std::size_t n = std::min(kLargest, n_bytes - done);
        copy_and_wait(source.handle, to.handle, {offset_bytes + done, 0, n});
        std::memcpy(static_cast<std::byte*>(data) + done, to.mapped, n);
    }
}

void Transfers::copy(const Buffer::Impl& source, const Buffer::Impl& target, std::size_t n_bytes) {
    const std::lock_guard lock(mutex_);
    copy_and_wait(source.handle, target.handle, {0, 0, n_bytes});
}

/// Copies and waits until the copy is complete. No barrier is needed before it, because
/// every submission of a stream ends with a barrier.
void Transfers::copy_and_wait(VkBuffer source, VkBuffer target, const VkBufferCopy& region) {
    if (!done_) make_commands();
    check(vkResetCommandPool(device_.device, pool_, 0), "vkResetCommandPool");
    VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    check(vkBeginCommandBuffer(commands_, &begin), "vkBeginCommandBuffer");
    vkCmdCopyBuffer(commands_, source, target, 1, &region);
    VkMemoryBarrier seen{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
    seen.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    seen.dstAccessMask = VK_ACCESS_HOST_READ_BIT | VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
    vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_TRANSFER_BIT,
                         VK_PIPELINE_STAGE_HOST_BIT | VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 1, &seen, 0,
                         nullptr, 0, nullptr);
    check(vkEndCommandBuffer(commands_), "vkEndCommandBuffer");
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &commands_;
    check(vkResetFences(device_.device, 1, &done_), "vkResetFences");
    device_.submit(info, done_);
    ++device_.n_full_waits;
    check(vkWaitForFences(device_.device, 1, &done_, VK_TRUE, ~std::uint64_t(0)), "vkWaitForFences");
}

}  // namespace relidar::gpu
