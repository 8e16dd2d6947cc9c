// SPDX-License-Identifier: Apache-2.0
// Allocates Vulkan buffers from pools of device memory. Checks the size before it calls
// the driver. Throws an error with the buffer's name if the device does not allow a
// buffer of this size.
#include "gpu/buffer.hpp"

#include <cstring>
#include <exception>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "gpu/transfers.hpp"

namespace relidar {

namespace {

double to_mib(std::uint64_t bytes) { return double(bytes) / 1048576.0; }

[[noreturn]] void fail_allocation(const Device::Impl& device, std::size_t size,
                                  const std::string& description, VkResult result) {
    const gpu::MemoryBudget budget = gpu::query_memory_budget(device.physical);
    gpu::fail(result,
              fmt::format("cannot allocate {:.1f} MiB for {} on {}: the driver returned {}; relidar uses "
                          "{:.1f} MiB, and {:.1f} MiB of the budget of {:.1f} MiB are free; use fewer "
                          "frames or a device with more memory",
                          to_mib(size), description, device.info.name, gpu::get_result_name(result),
                          to_mib(device.allocated), to_mib(budget.n_free()), to_mib(budget.n_bytes)));
}

void check_size(const Device::Impl& device, std::size_t size, const std::string& description) {
    const auto& [limit, name] = device.largest_buffer;
    if (size <= limit) return;
    throw DeviceError(
        fmt::format("cannot allocate {:.1f} MiB for {} on {}: the array is larger than {} = {:.1f} MiB, the "
                    "limit of the driver",
                    to_mib(size), description, device.info.name, name, to_mib(limit)));
}

void check_budget(const Device::Impl& device, std::size_t size, const std::string& description) {
    if (device.memory_limit_bytes == 0 || device.allocated + size <= device.memory_limit_bytes) return;
    throw DeviceError(
        fmt::format("cannot allocate {:.1f} MiB for {}: {:.1f} MiB are in use, and the memory limit is "
                    "{:.1f} MiB (RELIDAR_MEMORY_LIMIT_MIB)",
                    to_mib(size), description, to_mib(device.allocated), to_mib(device.memory_limit_bytes)));
}

}  // namespace

Buffer::Impl::Impl(Device::Impl& owner, std::size_t size, gpu::MemoryUse used, const std::string& description)
    : device(&owner), use(used), n_bytes(size) {
    // A driver without hardware can compile kernels but cannot allocate memory.
    if (owner.compile_only) return;
    owner.free_orphans();
    check_size(owner, size, description);
    // Checks the budget only for device memory, because all other buffers use host
    // memory.
    if (use == gpu::MemoryUse::device) check_budget(owner, size, description);
    VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    info.size = size;
    info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT |
                 VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    // Sets these usage flags only if the device traces with ray queries. Otherwise the
    // extension for acceleration structures is not enabled, so the flags are not allowed.
    if (owner.traversal == Traversal::ray_query)
        info.usage |= VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_BUILD_INPUT_READ_ONLY_BIT_KHR |
                      VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR;
    const VkResult created = vkCreateBuffer(owner.device, &info, nullptr, &handle);
    if (created != VK_SUCCESS) fail_allocation(owner, size, description, created);
    gpu::name_object(owner.device, VK_OBJECT_TYPE_BUFFER, handle, description);
    VkMemoryRequirements needs;
    vkGetBufferMemoryRequirements(owner.device, handle, &needs);
    const VkResult result = owner.memory->take(needs, use, memory);
    if (result != VK_SUCCESS) {
        vkDestroyBuffer(owner.device, handle, nullptr);
        fail_allocation(owner, size, description, result);
    }
    vkBindBufferMemory(owner.device, handle, memory.block->memory, memory.offset);
    VkBufferDeviceAddressInfo address_info{VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO};
    address_info.buffer = handle;
    address = vkGetBufferDeviceAddress(owner.device, &address_info);
    ++owner.n_buffers;
    if (use != gpu::MemoryUse::device) {
        mapped = memory.block->mapped + memory.offset;
        return;
    }
    owner.allocated += memory.n_bytes;
    if (owner.allocated > owner.peak) owner.peak = owner.allocated.load();
}

Buffer::Impl::~Impl() {
    if (!handle) return;
    // Usually the code that frees a buffer has waited for the commands that use it. An
    // exception skips this wait. Therefore waits here for the commands that are
    // submitted, and keeps the buffer if there are commands that are recorded only.
    if (std::uncaught_exceptions() > 0) {
        const std::lock_guard lock(device->orphans_mutex);
        if (device->n_recording > 0) {
            device->orphans.push_back({handle, memory, use});
            return;
        }
        device->wait_idle();
    }
    device->free_buffer({handle, memory, use});
}

void Device::Impl::free_buffer(const Orphan& buffer) noexcept {
    vkDestroyBuffer(device, buffer.handle, nullptr);
    memory->release(buffer.memory);
    if (buffer.use == gpu::MemoryUse::device) allocated -= buffer.memory.n_bytes;
}

void Device::Impl::free_orphans() {
    const std::lock_guard lock(orphans_mutex);
    if (orphans.empty() || n_recording > 0) return;
    wait_idle();
    for (const Orphan& orphan : orphans) free_buffer(orphan);
    orphans.clear();
}

Buffer::Buffer(Device& device, std::size_t n_bytes, const std::string& description)
    : impl_(std::make_unique<Impl>(get_impl(device), n_bytes, gpu::MemoryUse::device, description)) {}
Buffer::Buffer() = default;
Buffer::~Buffer() = default;
Buffer::Impl& get_impl(const Buffer& buffer) { return *buffer.impl_; }
Buffer::Buffer(Buffer&&) noexcept = default;
Buffer& Buffer::operator=(Buffer&&) noexcept = default;
std::uint64_t Buffer::address() const { return impl_ ? impl_->address : 0; }
std::size_t Buffer::size_bytes() const { return impl_ ? impl_->n_bytes : 0; }

void Buffer::upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes) {
    if (!impl_->device->compile_only) impl_->device->transfers->upload(*impl_, data, n_bytes, offset_bytes);
}

void Buffer::copy_from(const Buffer& source, std::size_t n_bytes) {
    if (!impl_->device->compile_only) impl_->device->transfers->copy(*source.impl_, *impl_, n_bytes);
}

void Buffer::download(void* data, std::size_t n_bytes, std::size_t offset_bytes) const {
    if (impl_->device->compile_only) std::memset(data, 0, n_bytes);
    else impl_->device->transfers->download(*impl_, data, n_bytes, offset_bytes);
}

}  // namespace relidar
