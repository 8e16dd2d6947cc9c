// SPDX-License-Identifier: Apache-2.0
// Memory for buffers, in blocks that many of them share: a driver may allow only 4096
// allocations (maxMemoryAllocationCount), and each costs a system call. An array of more
// than half a block has a block of its own. (Vulkan Memory Allocator would do this;
// Debian 12 does not package it.)
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "gpu/vulkan.hpp"

namespace relidar::gpu {

/// What memory is for, which decides its type. All but `device` is mapped for as long as
/// it lives, and coherent.
enum class MemoryUse {
    device,      ///< arrays of kernels
    parameters,  ///< written by the host, read by kernels: memory of the device where the host can write it
    upload,      ///< written by the host, read by copies
    readback,    ///< written by copies, read by the host: cached where there is such memory
};

/// Which parts of a block are free.
class FreeRanges {
public:
    explicit FreeRanges(std::uint64_t n_bytes) : n_bytes_(n_bytes), ranges_{{0, n_bytes}} {}
    /// Takes the first free range that fits. @param alignment a power of two @return its
    /// offset, or nothing where none fits
    std::optional<std::uint64_t> take(std::uint64_t n_bytes, std::uint64_t alignment);
    void give_back(std::uint64_t offset, std::uint64_t n_bytes);
    bool all_free() const { return ranges_.size() == 1 && ranges_.begin()->second == n_bytes_; }

private:
    std::uint64_t n_bytes_;
    std::map<std::uint64_t, std::uint64_t> ranges_;  ///< offset -> bytes; no two touch
};

/// One allocation of the driver.
struct MemoryBlock {
    VkDeviceMemory memory = VK_NULL_HANDLE;
    std::uint32_t type = 0;
    std::uint64_t n_bytes = 0;
    std::byte* mapped = nullptr;  ///< where one of its users is the host
    FreeRanges free;
};

/// The part of a block that one buffer has.
struct MemoryPiece {
    MemoryBlock* block = nullptr;
    std::uint64_t offset = 0;
    std::uint64_t n_bytes = 0;
};

/// All memory of a device. May be used by several threads.
class MemoryPools {
public:
    static constexpr std::uint64_t kBlockBytes = std::uint64_t(64) << 20;

    MemoryPools(VkPhysicalDevice physical, VkDevice device);
    ~MemoryPools();
    MemoryPools(const MemoryPools&) = delete;
    MemoryPools& operator=(const MemoryPools&) = delete;

    /// @param piece set where the answer is VK_SUCCESS @return what the driver said of
    /// the last type of memory tried
    VkResult take(const VkMemoryRequirements& needs, MemoryUse use, MemoryPiece& piece);
    void give_back(const MemoryPiece& piece);
    std::size_t n_blocks() const;

private:
    using Blocks = std::vector<std::unique_ptr<MemoryBlock>>;

    VkDevice device_;
    VkPhysicalDeviceMemoryProperties properties_{};
    mutable std::mutex mutex_;
    std::array<Blocks, VK_MAX_MEMORY_TYPES> blocks_;  ///< of each type

    std::vector<std::uint32_t> types(const VkMemoryRequirements& needs, MemoryUse use) const;
    std::uint64_t shared_bytes(std::uint32_t type) const;
    bool take_of_type(const VkMemoryRequirements& needs, std::uint32_t type, MemoryPiece& piece);
    VkResult grow(const VkMemoryRequirements& needs, std::uint32_t type, MemoryPiece& piece);
    VkResult map(MemoryBlock& block);
    VkResult add_block(std::uint32_t type, std::uint64_t n_bytes);
    void release_empty(std::uint32_t type, std::size_t n_kept);
};

}  // namespace relidar::gpu
