// SPDX-License-Identifier: Apache-2.0
// Blocking copies between host and device, for code whose speed does not matter. The
// first copy creates the command buffer and a staging buffer per direction. Thread-safe.
#pragma once

#include "gpu/buffer.hpp"

namespace relidar::gpu {

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
