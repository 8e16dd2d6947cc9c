// SPDX-License-Identifier: Apache-2.0
// The Vulkan buffer behind relidar::Buffer, and a variant in memory that the host reads
// or writes.
#pragma once

#include "gpu/context.hpp"
#include "gpu/memory.hpp"

namespace relidar {

struct Buffer::Impl {
    Device::Impl* device = nullptr;
    VkBuffer handle = VK_NULL_HANDLE;
    gpu::MemoryPiece memory;
    gpu::MemoryUse use;
    std::uint64_t address = 0;
    std::size_t n_bytes = 0;
    std::byte* mapped = nullptr;  ///< null if the memory is not mapped to the host

    /// Creates the buffer and binds memory to it.
    /// @throws DeviceError if the memory is exhausted or the size exceeds the limit of
    /// one buffer
    Impl(Device::Impl& device, std::size_t n_bytes, gpu::MemoryUse use, const std::string& what);
    ~Impl();
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;
};

}  // namespace relidar
