// SPDX-License-Identifier: Apache-2.0
// The Vulkan buffer behind relidar::Buffer, and the same over memory that the host reads
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
    std::byte* mapped = nullptr;  ///< null for arrays of kernels

    /// @throws DeviceError where memory is exhausted or one buffer cannot be so large
    Impl(Device::Impl& device, std::size_t n_bytes, gpu::MemoryUse use, const std::string& what);
    ~Impl();
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;
};

}  // namespace relidar
