// SPDX-License-Identifier: Apache-2.0
// Device memory: one allocation a long-lived array (we hold few, large ones), blocking copies through staging memory.
#include "gpu/buffer.hpp"

#include <cstring>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {

namespace {

constexpr std::size_t kStagingBytes = std::size_t(32) << 20;

/// Runs one copy command and waits: uploads and downloads are outside the hot path.
void copy_now(Device::Impl& device, VkBuffer from, VkBuffer to, const VkBufferCopy& region) {
    VkCommandPoolCreateInfo pool_info{VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    pool_info.queueFamilyIndex = device.queue_family;
    VkCommandPool pool = VK_NULL_HANDLE;
    gpu::check(vkCreateCommandPool(device.device, &pool_info, nullptr, &pool), "vkCreateCommandPool");
    VkCommandBufferAllocateInfo allocate{VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
    allocate.commandPool = pool;
    allocate.commandBufferCount = 1;
    VkCommandBuffer commands = VK_NULL_HANDLE;
    VkResult result = vkAllocateCommandBuffers(device.device, &allocate, &commands);
    if (result == VK_SUCCESS) {
        VkCommandBufferBeginInfo begin{VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
        begin.flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT;
        vkBeginCommandBuffer(commands, &begin);
        vkCmdCopyBuffer(commands, from, to, 1, &region);
        vkEndCommandBuffer(commands);
        VkSubmitInfo submit{VK_STRUCTURE_TYPE_SUBMIT_INFO};
        submit.commandBufferCount = 1;
        submit.pCommandBuffers = &commands;
        result = vkQueueSubmit(device.queue, 1, &submit, VK_NULL_HANDLE);
        if (result == VK_SUCCESS) result = vkQueueWaitIdle(device.queue);
    }
    vkDestroyCommandPool(device.device, pool, nullptr);
    gpu::check(result, "copying a buffer");
}

DeviceError out_of_memory(const Device::Impl& device, std::size_t size, const std::string& what, VkResult result) {
    return DeviceError(fmt::format("allocating {:.1f} MiB for {}: the driver answered {} with {:.1f} MiB in use, expected room on {}", double(size) / 1048576.0, what,
                                   gpu::result_name(result), double(device.allocated) / 1048576.0, device.info.name));
}

/// The budget is of device-local memory: staging and parameters are the host's.
void check_budget(const Device::Impl& device, std::size_t size, const std::string& what) {
    if (device.memory_limit_bytes == 0 || device.allocated + size <= device.memory_limit_bytes) return;
    throw DeviceError(fmt::format("allocating {:.1f} MiB for {}: found {:.1f} MiB in use, expected to stay within the limit of {:.1f} MiB", double(size) / 1048576.0, what,
                                  double(device.allocated) / 1048576.0, double(device.memory_limit_bytes) / 1048576.0));
}

}  // namespace

Buffer::Impl::Impl(Device::Impl& owner, std::size_t size, bool host_visible, const std::string& what) : device(&owner), n_bytes(size) {
    if (!host_visible) check_budget(owner, size, what);
    VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    info.size = size;
    info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT | VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    if (owner.traversal == Traversal::ray_query)
        info.usage |= VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_BUILD_INPUT_READ_ONLY_BIT_KHR | VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR;
    const VkResult created = vkCreateBuffer(owner.device, &info, nullptr, &handle);
    if (created != VK_SUCCESS) throw out_of_memory(owner, size, what, created);
    VkMemoryRequirements needs;
    vkGetBufferMemoryRequirements(owner.device, handle, &needs);
    const VkMemoryPropertyFlags wanted = host_visible ? VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT : VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT;
    VkMemoryAllocateFlagsInfo flags{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO};
    flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
    VkMemoryAllocateInfo allocate{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, &flags};
    allocate.allocationSize = needs.size;
    allocate.memoryTypeIndex = owner.memory_type(needs.memoryTypeBits, wanted);
    const VkResult result = vkAllocateMemory(owner.device, &allocate, nullptr, &memory);
    if (result != VK_SUCCESS) {
        vkDestroyBuffer(owner.device, handle, nullptr);
        throw out_of_memory(owner, size, what, result);
    }
    allocated_bytes = needs.size;
    vkBindBufferMemory(owner.device, handle, memory, 0);
    VkBufferDeviceAddressInfo address_info{VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO};
    address_info.buffer = handle;
    address = vkGetBufferDeviceAddress(owner.device, &address_info);
    void* pointer = nullptr;
    if (host_visible) gpu::check(vkMapMemory(owner.device, memory, 0, VK_WHOLE_SIZE, 0, &pointer), "vkMapMemory");
    mapped = static_cast<std::byte*>(pointer);
    owner.allocated += allocated_bytes;
    if (owner.allocated > owner.peak) owner.peak = owner.allocated.load();
}

Buffer::Impl::~Impl() {
    vkDestroyBuffer(device->device, handle, nullptr);
    vkFreeMemory(device->device, memory, nullptr);
    device->allocated -= allocated_bytes;
}

Buffer::Buffer(Device& device, std::size_t n_bytes, const std::string& what) : impl_(std::make_unique<Impl>(device.impl(), n_bytes, false, what)) {}
Buffer::Buffer() = default;
Buffer::~Buffer() = default;
Buffer::Buffer(Buffer&&) noexcept = default;
Buffer& Buffer::operator=(Buffer&&) noexcept = default;
std::uint64_t Buffer::address() const { return impl_ ? impl_->address : 0; }
std::size_t Buffer::size_bytes() const { return impl_ ? impl_->n_bytes : 0; }

void Buffer::upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes) {
    Impl staging(*impl_->device, std::min(n_bytes, kStagingBytes), true, "staging");
    for (std::size_t done = 0; done < n_bytes; done += kStagingBytes) {
        const std::size_t n = std::min(kStagingBytes, n_bytes - done);
        std::memcpy(staging.mapped, static_cast<const std::byte*>(data) + done, n);
        copy_now(*impl_->device, staging.handle, impl_->handle, {0, offset_bytes + done, n});
    }
}

void Buffer::copy_from(const Buffer& source, std::size_t n_bytes) { copy_now(*impl_->device, source.impl_->handle, impl_->handle, {0, 0, n_bytes}); }

void Buffer::download(void* data, std::size_t n_bytes, std::size_t offset_bytes) const {
    Impl staging(*impl_->device, std::min(n_bytes, kStagingBytes), true, "staging");
    for (std::size_t done = 0; done < n_bytes; done += kStagingBytes) {
        const std::size_t n = std::min(kStagingBytes, n_bytes - done);
        copy_now(*impl_->device, impl_->handle, staging.handle, {offset_bytes + done, 0, n});
        std::memcpy(static_cast<std::byte*>(data) + done, staging.mapped, n);
    }
}

}  // namespace relidar
