// SPDX-License-Identifier: Apache-2.0
// Copies data between host and device through staging memory, at most 32 MiB at a time.
#include "gpu/buffer.hpp"

#include <algorithm>
#include <bit>
#include <cstring>

namespace relidar::gpu {

namespace {

constexpr std::size_t kMinStagingBytes = std::size_t(64) << 10, kMaxStagingBytes = std::size_t(32) << 20;

}  // namespace

/// Creates a command buffer and a fence, which all copies share.
void BufferTransfers::create_commands() {
    VkCommandPoolCreateInfo pool{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    pool.queueFamilyIndex = device_.queue_family;
    vk_check(vkCreateCommandPool(device_.device, &pool, nullptr, &pool_), "vkCreateCommandPool");
    VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
    allocate.commandPool = pool_;
    allocate.commandBufferCount = 1;
    vk_check(vkAllocateCommandBuffers(device_.device, &allocate, &commands_), "vkAllocateCommandBuffers");
    set_object_name(device_.device, VK_OBJECT_TYPE_COMMAND_POOL, pool_, "copies");
    set_object_name(device_.device, VK_OBJECT_TYPE_COMMAND_BUFFER, commands_, "copies");
    const VkFenceCreateInfo fence{VK_STRUCTURE_TYPE_FENCE_CREATE_INFO};
    vk_check(vkCreateFence(device_.device, &fence, nullptr, &done_), "vkCreateFence");
    set_object_name(device_.device, VK_OBJECT_TYPE_FENCE, done_, "copy is done");
}

BufferTransfers::~BufferTransfers() {
    vkDestroyFence(device_.device, done_, nullptr);
    vkDestroyCommandPool(device_.device, pool_, nullptr);
}

Buffer::Impl& BufferTransfers::ensure_staging(std::unique_ptr<Buffer::Impl>& staging, BufferPurpose purpose,
                                              std::size_t n_bytes) {
    const std::size_t staging_bytes = std::clamp(std::bit_ceil(n_bytes), kMinStagingBytes, kMaxStagingBytes);
    if (!staging || staging->n_bytes < staging_bytes) {
        staging.reset();
        staging = std::make_unique<Buffer::Impl>(device_, staging_bytes, purpose, "staging");
    }
    return *staging;
}

/// Copies host data to a buffer, in pieces that fit into the staging memory.
void BufferTransfers::upload(const Buffer::Impl& target, const void* data, std::size_t n_bytes,
                             std::size_t offset_bytes) {
    const std::lock_guard lock(mutex_);
    ++device_.n_uploads;
    device_.upload_bytes += n_bytes;
    const Buffer::Impl& from = ensure_staging(upload_, BufferPurpose::upload, n_bytes);
    // copy_now() waits for each copy, so the staging memory can be used again.
    for (std::size_t done = 0; done < n_bytes; done += kMaxStagingBytes) {
        const std::size_t n = std::min(kMaxStagingBytes, n_bytes - done);
        std::memcpy(from.mapped, static_cast<const std::byte*>(data) + done, n);
        copy_now(from.handle, target.handle, {.srcOffset = 0, .dstOffset = offset_bytes + done, .size = n});
    }
}

/// Copies a part of a buffer to the host, in pieces that fit into the staging memory.
void BufferTransfers::download(const Buffer::Impl& source, void* data, std::size_t n_bytes,
                               std::size_t offset_bytes) {
    const std::lock_guard lock(mutex_);
    ++device_.n_downloads;
    device_.download_bytes += n_bytes;
    const Buffer::Impl& to = ensure_staging(download_, BufferPurpose::readback, n_bytes);
    for (std::size_t done = 0; done < n_bytes; done += kMaxStagingBytes) {
        const std::size_t n = std::min(kMaxStagingBytes, n_bytes - done);
        copy_now(source.handle, to.handle, {.srcOffset = offset_bytes + done, .dstOffset = 0, .size = n});
        std::memcpy(static_cast<std::byte*>(data) + done, to.mapped, n);
    }
}

void BufferTransfers::copy_buffer(const Buffer::Impl& source, const Buffer::Impl& target,
                                  std::size_t n_bytes) {
    const std::lock_guard lock(mutex_);
    copy_now(source.handle, target.handle, {0, 0, n_bytes});
}

/// Copies and waits until the copy is complete. Needs no barrier before the copy, because
/// every submission of a stream ends with one. The barrier after the copy makes the bytes
/// visible to the host and to all later commands.
void BufferTransfers::copy_now(VkBuffer source, VkBuffer target, const VkBufferCopy& region) {
    if (!done_) create_commands();
    vk_check(vkResetCommandPool(device_.device, pool_, 0), "vkResetCommandPool");
    VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
    vk_check(vkBeginCommandBuffer(commands_, &begin), "vkBeginCommandBuffer");
    vkCmdCopyBuffer(commands_, source, target, 1, &region);
    VkMemoryBarrier memory_barrier{VK_STRUCTURE_TYPE_MEMORY_BARRIER};
    memory_barrier.srcAccessMask = VK_ACCESS_TRANSFER_WRITE_BIT;
    memory_barrier.dstAccessMask =
        VK_ACCESS_HOST_READ_BIT | VK_ACCESS_MEMORY_READ_BIT | VK_ACCESS_MEMORY_WRITE_BIT;
    vkCmdPipelineBarrier(commands_, VK_PIPELINE_STAGE_TRANSFER_BIT,
                         VK_PIPELINE_STAGE_HOST_BIT | VK_PIPELINE_STAGE_ALL_COMMANDS_BIT, 0, 1,
                         &memory_barrier, 0, nullptr, 0, nullptr);
    vk_check(vkEndCommandBuffer(commands_), "vkEndCommandBuffer");
    VkSubmitInfo info{VK_STRUCTURE_TYPE_SUBMIT_INFO};
    info.commandBufferCount = 1;
    info.pCommandBuffers = &commands_;
    vk_check(vkResetFences(device_.device, 1, &done_), "vkResetFences");
    device_.submit_to_queue(info, done_);
    ++device_.n_full_waits;
    vk_check(vkWaitForFences(device_.device, 1, &done_, VK_TRUE, ~std::uint64_t(0)), "vkWaitForFences");
}

}  // namespace relidar::gpu
