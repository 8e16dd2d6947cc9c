// SPDX-License-Identifier: Apache-2.0
// Implements relidar::Buffer. Also used for memory that the host reads or writes.
#pragma once

#include "gpu/context.hpp"
#include "gpu/memory.hpp"

namespace relidar {

struct Buffer::Impl {
    Device::Impl* device = nullptr;
    VkBuffer handle = VK_NULL_HANDLE;
    /// Several pieces if the buffer is larger than the driver's maximum allocation.
    std::vector<gpu::MemorySuballocation> memory;
    gpu::BufferPurpose use;
    std::uint64_t address = 0;
    std::size_t n_bytes = 0;
    std::byte* mapped = nullptr;

    Impl(Device::Impl& device, std::size_t n_bytes, gpu::BufferPurpose use, const std::string& text);
    ~Impl();
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;

private:
    bool is_array() const { return use == gpu::BufferPurpose::device; }
    VkResult create_handle(bool is_sparse);
    VkResult allocate(const VkMemoryRequirements& requirements);
    VkResult allocate_sparse(const VkMemoryRequirements& requirements);
    void count_array_memory();
};

}  // namespace relidar

namespace relidar::gpu {

/// Blocking copies between host and device, for code whose speed does not matter. The
/// first copy creates the command buffer and a staging buffer per direction. Thread-safe.
class BufferTransfers {
public:
    explicit BufferTransfers(Device::Impl& device) : device_(device) {}
    ~BufferTransfers();

    void upload(const Buffer::Impl& target, const void* data, std::size_t n_bytes, std::size_t offset_bytes);
    void download(const Buffer::Impl& source, void* data, std::size_t n_bytes, std::size_t offset_bytes);
    void copy_buffer(const Buffer::Impl& source, const Buffer::Impl& target, std::size_t n_bytes);

private:
    Device::Impl& device_;
    std::mutex mutex_;
    VkCommandPool pool_ = VK_NULL_HANDLE;
    VkCommandBuffer commands_ = VK_NULL_HANDLE;
    VkFence done_ = VK_NULL_HANDLE;
    std::unique_ptr<Buffer::Impl> upload_, download_;

    void create_commands();
    Buffer::Impl& ensure_staging(std::unique_ptr<Buffer::Impl>& staging, BufferPurpose purpose,
                                 std::size_t n_bytes);
    void copy_now(VkBuffer source, VkBuffer target, const VkBufferCopy& region);
};

}  // namespace relidar::gpu
