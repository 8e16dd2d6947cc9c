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
    /// As one piece, or (sparse binding) as pieces of at most `max_bytes`.
    VkResult allocate(const VkMemoryRequirements& requirements);
    VkResult allocate_sparse(const VkMemoryRequirements& requirements, std::uint64_t max_bytes);
};

}  // namespace relidar
