// SPDX-License-Identifier: Apache-2.0
#include "gpu/buffer.hpp"

#include <algorithm>
#include <cstring>
#include <exception>

#include <fmt/format.h>

#include <relidar/gpu/out_of_memory.hpp>
#include "base/fail.hpp"

#include "gpu/external_memory.hpp"

namespace relidar {

namespace {

// Converts to MiB (2^20 bytes), for error messages.
double bytes_to_mib(std::uint64_t bytes) { return double(bytes) / 1048576.0; }

/// Throws an error with the size of the buffer, the free memory and the cause.
/// @param cause for example the error code of the driver
[[noreturn]] void fail_allocation(const Device::Impl& device, std::size_t size, const std::string& text,
                                  const std::string& cause, const gpu::MemoryBudget& budget) {
    fail<OutOfDeviceMemory>(
        "cannot allocate {:.1f} MiB for {} on {}: {}; relidar uses {:.1f} MiB, and {:.1f} MiB of the memory "
        "budget of {:.1f} MiB are free; use fewer frames or a device with more memory",
        bytes_to_mib(size), text, device.info.name, cause, bytes_to_mib(device.allocated),
        bytes_to_mib(budget.free_bytes()), bytes_to_mib(budget.n_bytes));
}

void check_buffer_size(const Device::Impl& device, std::size_t size_bytes, const std::string& text) {
    const auto& [limit, name] = device.largest_buffer;
    if (size_bytes <= limit) return;
    fail<OutOfDeviceMemory>(
        "cannot allocate {:.1f} MiB for {} on {}: the driver allows at most {:.1f} MiB ({})",
        bytes_to_mib(size_bytes), text, device.info.name, bytes_to_mib(limit), name);
}

/// Checks that an array fits into the memory limit of the user and into the memory budget
/// of the driver. Reading the budget is slow, so it is read only for large arrays.
void check_budget(const Device::Impl& device, std::size_t size_bytes, const std::string& text) {
    constexpr std::size_t kLargeArrayBytes = gpu::DeviceMemoryAllocator::kBlockBytes / 2;
    if (device.memory_limit_bytes != 0 && device.allocated + size_bytes > device.memory_limit_bytes)
        fail<OutOfDeviceMemory>(
            "cannot allocate {:.1f} MiB for {}: relidar uses {:.1f} MiB, and its memory limit is {:.1f} MiB "
            "(environment variable RELIDAR_MEMORY_LIMIT_MIB)",
            bytes_to_mib(size_bytes), text, bytes_to_mib(device.allocated),
            bytes_to_mib(device.memory_limit_bytes));
    if (size_bytes < kLargeArrayBytes) return;
    gpu::MemoryBudget budget = gpu::query_budget(device.physical);
    // Without VK_EXT_memory_budget, the driver does not report the used memory (n_used is
    // 0), so the memory of this process is the best estimate.
    budget.n_used = std::max(budget.n_used, device.allocated.load());
    if (budget.n_bytes > 0 && size_bytes > budget.free_bytes())
        fail_allocation(device, size_bytes, text, "the array is larger than the free device memory", budget);
}

}  // namespace

/// Creates a buffer and binds memory to it. An array that is larger than the largest
/// allocation of the driver becomes a sparse buffer of several pieces.
Buffer::Impl::Impl(Device::Impl& owner, std::size_t size, gpu::BufferPurpose used, const std::string& text)
    : device(&owner), use(used), n_bytes(size) {
    // A device that only compiles may have no hardware, so it allocates no memory.
    if (owner.compile_only) return;
    owner.check_process();  // throws in a forked process
    owner.free_orphans();   // buffers that could not be destroyed earlier
    check_buffer_size(owner, size, text);
    // Other buffers are small or in host memory, so the budget does not apply to them.
    if (is_array()) check_budget(owner, size, text);
    const bool is_sparse = is_array() && owner.binds_sparse && size > owner.largest_allocation.n_bytes;
    VkResult result = create_handle(is_sparse);
    if (result == VK_SUCCESS) {
        gpu::set_object_name(owner.device, VK_OBJECT_TYPE_BUFFER, handle, text);
        VkMemoryRequirements needs;
        vkGetBufferMemoryRequirements(owner.device, handle, &needs);
        result = is_sparse ? allocate_sparse(needs) : allocate(needs);
    }
    if (result != VK_SUCCESS) {  // of create_handle() or of the allocation
        for (const gpu::MemorySuballocation& piece : memory) owner.memory->release(piece);
        vkDestroyBuffer(owner.device, handle, nullptr);
        const std::string cause = fmt::format("the driver returned {}", gpu::vk_result_name(result));
        // A lost device is not a lack of memory.
        if (result == VK_ERROR_DEVICE_LOST)
            gpu::vk_fail(result, fmt::format("cannot allocate {}: {}", text, cause));
        fail_allocation(owner, size, text, cause, gpu::query_budget(owner.physical));
    }
    VkBufferDeviceAddressInfo address_info{VK_STRUCTURE_TYPE_BUFFER_DEVICE_ADDRESS_INFO};
    address_info.buffer = handle;
    address = vkGetBufferDeviceAddress(owner.device, &address_info);
    if (memory.size() == 1 && memory.front().block->mapped)
        mapped = memory.front().block->mapped + memory.front().offset;
    ++owner.n_buffers;
    if (is_array()) count_array_memory();
}

VkResult Buffer::Impl::create_handle(bool is_sparse) {
    VkBufferCreateInfo info{VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    info.size = n_bytes;
    info.flags = is_sparse ? VK_BUFFER_CREATE_SPARSE_BINDING_BIT : 0;
    info.usage = VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT |
                 VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    // Vulkan allows these flags only if the extension for acceleration structures is
    // enabled. This is the case if the device traces with ray queries.
    if (device->traversal == RayTracingBackend::ray_query)
        info.usage |= VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_BUILD_INPUT_READ_ONLY_BIT_KHR |
                      VK_BUFFER_USAGE_ACCELERATION_STRUCTURE_STORAGE_BIT_KHR;
    VkExternalMemoryBufferCreateInfo external{VK_STRUCTURE_TYPE_EXTERNAL_MEMORY_BUFFER_CREATE_INFO};
    external.handleTypes = VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT;
    if (device->exports_memory && is_array()) info.pNext = &external;
    return vkCreateBuffer(device->device, &info, nullptr, &handle);
}

/// Adds the memory of this array to Device::allocated_bytes() and Device::peak_bytes().
void Buffer::Impl::count_array_memory() {
    for (const gpu::MemorySuballocation& piece : memory) device->allocated += piece.n_bytes;
    if (device->allocated > device->peak) device->peak = device->allocated.load();
}

VkResult Buffer::Impl::allocate(const VkMemoryRequirements& requirements) {
    const VkResult result = device->memory->suballocate(requirements, use, memory.emplace_back());
    if (result != VK_SUCCESS) {
        memory.clear();
        return result;
    }
    return vkBindBufferMemory(device->device, handle, memory.front().block->memory, memory.front().offset);
}

/// Allocates the pieces of a sparse buffer and binds them. On failure, the caller frees
/// the allocated pieces.
VkResult Buffer::Impl::allocate_sparse(const VkMemoryRequirements& requirements) {
    // A piece must be a multiple of a memory page (the alignment), and at least one page.
    const std::uint64_t page_bytes = requirements.alignment;
    const std::uint64_t max_bytes =
        std::max(device->largest_allocation.n_bytes / page_bytes * page_bytes, page_bytes);
    for (std::uint64_t offset = 0; offset < requirements.size; offset += max_bytes) {
        VkMemoryRequirements piece_needs = requirements;
        piece_needs.size = std::min(max_bytes, requirements.size - offset);
        gpu::MemorySuballocation piece;
        const VkResult result = device->memory->suballocate(piece_needs, use, piece);
        if (result != VK_SUCCESS) return result;
        memory.push_back(piece);
    }
    return device->bind_sparse(handle, memory);
}

/// Binds pieces of memory to consecutive parts of a sparse buffer. Waits for the queue,
/// so that the caller can use the buffer immediately.
VkResult Device::Impl::bind_sparse(VkBuffer buffer, const std::vector<gpu::MemorySuballocation>& pieces) {
    std::vector<VkSparseMemoryBind> binds;
    VkDeviceSize offset = 0;
    for (const gpu::MemorySuballocation& piece : pieces) {
        binds.push_back({offset, piece.n_bytes, piece.block->memory, piece.offset, 0});
        offset += piece.n_bytes;
    }
    const VkSparseBufferMemoryBindInfo of_buffer{buffer, static_cast<std::uint32_t>(binds.size()),
                                                 binds.data()};
    VkBindSparseInfo bind{VK_STRUCTURE_TYPE_BIND_SPARSE_INFO};
    bind.bufferBindCount = 1;
    bind.pBufferBinds = &of_buffer;
    const std::lock_guard lock(queue_mutex);
    const VkResult result = vkQueueBindSparse(queue, 1, &bind, VK_NULL_HANDLE);
    return result == VK_SUCCESS ? vkQueueWaitIdle(queue) : result;
}

/// Destroys the buffer, after the device has finished all commands that may use it.
Buffer::Impl::~Impl() {
    if (!handle || device->is_forked()) return;
    // Usually, the owner waits for the commands that use a buffer before it destroys the
    // buffer. An exception skips this wait, so this destructor waits for submitted
    // commands. Commands that a stream has only recorded may be submitted later. In this
    // case, the buffer is put into `orphans`, which is freed later.
    if (std::uncaught_exceptions() > 0) {
        const std::lock_guard lock(device->orphans_mutex);
        if (device->n_recording > 0) {
            device->orphans.push_back({handle, memory, use});
            return;
        }
        device->wait_idle();
    }
    device->destroy_buffer({handle, memory, use});
}

void Device::Impl::destroy_buffer(const OrphanedBuffer& buffer) noexcept {
    vkDestroyBuffer(device, buffer.handle, nullptr);
    for (const gpu::MemorySuballocation& piece : buffer.memory) {
        memory->release(piece);
        if (buffer.use == gpu::BufferPurpose::device) allocated -= piece.n_bytes;
    }
}

/// Frees the buffers that were kept after exceptions. Does nothing while a stream has
/// recorded commands, because these commands may use the buffers.
void Device::Impl::free_orphans() {
    const std::lock_guard lock(orphans_mutex);
    if (orphans.empty() || n_recording > 0) return;
    wait_idle();
    for (const OrphanedBuffer& orphan : orphans) destroy_buffer(orphan);
    orphans.clear();
}

Buffer::Buffer(Device& device, std::size_t n_bytes, const std::string& text)
    : impl_(std::make_shared<Impl>(device.impl(), n_bytes, gpu::BufferPurpose::device, text)) {}
Buffer::Buffer() = default;
Buffer::~Buffer() = default;
Buffer::Buffer(Buffer&&) noexcept = default;
Buffer& Buffer::operator=(Buffer&&) noexcept = default;
std::uint64_t Buffer::device_address() const { return impl_ ? impl_->address : 0; }
std::size_t Buffer::size_bytes() const { return impl_ ? impl_->n_bytes : 0; }

Buffer Buffer::share() const {
    Buffer other;
    other.impl_ = impl_;
    return other;
}

MemoryAddress Buffer::address_for_others() const {
    using enum MemoryAddress::Interface;
    // A sparse buffer of several pieces has no common address.
    if (!impl_ || !impl_->device->share_memory || impl_->memory.size() != 1) return {};
    if (impl_->mapped) return {host, impl_->mapped, 0};
    const gpu::MemorySuballocation& piece = impl_->memory.front();
    if (!piece.block->exports) return {};
    MemoryAddress address = gpu::import_block(*impl_->device, *piece.block);
    if (address.pointer) address.pointer += piece.offset;
    return address;
}

void Buffer::upload(const void* data, std::size_t n_bytes, std::size_t offset_bytes) {
    if (!impl_->device->compile_only) impl_->device->transfers->upload(*impl_, data, n_bytes, offset_bytes);
}

void Buffer::copy_from(const Buffer& source, std::size_t n_bytes) {
    if (!impl_->device->compile_only) impl_->device->transfers->copy_buffer(*source.impl_, *impl_, n_bytes);
}

void Buffer::download(void* data, std::size_t n_bytes, std::size_t offset_bytes) const {
    if (impl_->device->compile_only) std::memset(data, 0, n_bytes);
    else impl_->device->transfers->download(*impl_, data, n_bytes, offset_bytes);
}

}  // namespace relidar
