// SPDX-License-Identifier: Apache-2.0
// Blocking copies between host and device, for code that need not be fast. Creates one
// command buffer and one staging buffer per direction at the first copy. Thread-safe.
#pragma once

#include <memory>
#include <mutex>

#include "gpu/buffer.hpp"

namespace relidar::gpu {

class Transfers {
public:
    explicit Transfers(Device::Impl& device) : device_(device) {}
    ~Transfers();
    Transfers(const Transfers&) = delete;
    Transfers& operator=(const Transfers&) = delete;

    void upload(const Buffer::Impl& to, const void* data, std::size_t n_bytes, std::size_t offset_bytes);
    void download(const Buffer::Impl& from, void* data, std::size_t n_bytes, std::size_t offset_bytes);
    /// Copies the first bytes of one buffer to another.
    void copy(const Buffer::Impl& from, const Buffer::Impl& to, std::size_t n_bytes);

private:
    Device::Impl& device_;
    std::mutex mutex_;
    VkCommandPool pool_ = VK_NULL_HANDLE;
    VkCommandBuffer commands_ = VK_NULL_HANDLE;
    VkFence done_ = VK_NULL_HANDLE;
    /// Staging buffers for both directions. Null until the first copy.
    std::unique_ptr<Buffer::Impl> upload_, download_;

    void make_commands();
    Buffer::Impl& staging(std::unique_ptr<Buffer::Impl>& buffer, MemoryUse use, std::size_t n_bytes);
    void copy_and_wait(VkBuffer from, VkBuffer to, const VkBufferCopy& region);
};

}  // namespace relidar::gpu
