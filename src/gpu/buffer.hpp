// SPDX-License-Identifier: Apache-2.0
// Vulkan objects behind relidar::Buffer, and host-visible memory for staging and parameters.
#pragma once

#include "gpu/context.hpp"

namespace relidar {

struct Buffer::Impl {
    Device::Impl* device = nullptr;
    VkBuffer handle = VK_NULL_HANDLE;
    VkDeviceMemory memory = VK_NULL_HANDLE;
    std::uint64_t address = 0;
    std::size_t n_bytes = 0;
    std::size_t allocated_bytes = 0;
    std::byte* mapped = nullptr;   ///< host-visible memory only

    /// Device-local, or host-visible and mapped for as long as it lives. @throws DeviceError where memory is exhausted
    Impl(Device::Impl& device, std::size_t n_bytes, bool host_visible, const std::string& what);
    ~Impl();
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;
};

}  // namespace relidar
