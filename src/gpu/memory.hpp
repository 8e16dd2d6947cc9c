// SPDX-License-Identifier: Apache-2.0
// Device memory for buffers, allocated in blocks that many buffers share. Blocks are
// needed because a driver may allow only 4096 allocations (maxMemoryAllocationCount), and
// each allocation costs a system call. An array larger than half a block gets a separate
// block. (Vulkan Memory Allocator has this function, but Debian 12 does not package it.)
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

/// Purpose of memory, which determines its Vulkan memory type. All memory except `device`
/// is host-coherent and mapped as long as it exists.
enum class MemoryUse {
    device,  ///< Arrays of kernels.
    /// The host writes this memory and kernels read it. Uses device memory that the host
    /// can write, if such memory exists.
    parameters,
    upload,  ///< Written by the host, read by copies.
    /// Copies write this memory and the host reads it. Uses host-cached memory if such
    /// memory exists.
    readback,
};

/// Device memory that this process may use.
struct MemoryBudget {
    std::uint64_t n_bytes = 0;  ///< Budget of the largest device-local heap.
    std::uint64_t n_used = 0;   ///< Memory of the heap that this process uses.

    std::uint64_t n_free() const { return n_bytes > n_used ? n_bytes - n_used : 0; }
};
/// Returns the current budget. It depends on other programs if the driver has
/// VK_EXT_memory_budget. Otherwise it is the size of the heap, and n_used is 0.
MemoryBudget memory_budget(VkPhysicalDevice physical);

/// Free ranges of a block.
class FreeRanges {
public:
    explicit FreeRanges(std::uint64_t n_bytes) : n_bytes_(n_bytes), ranges_{{0, n_bytes}} {}
    /// Allocates the first free range that is large enough.
    /// @param alignment a power of two
    /// @return offset of the range, or nullopt if no range is large enough
    std::optional<std::uint64_t> take(std::uint64_t n_bytes, std::uint64_t alignment);
    void release(std::uint64_t offset, std::uint64_t n_bytes);
    bool all_free() const { return ranges_.size() == 1 && ranges_.begin()->second == n_bytes_; }

private:
    std::uint64_t n_bytes_;
    /// Free ranges: map from offset to size in bytes. Adjacent ranges are merged.
    std::map<std::uint64_t, std::uint64_t> ranges_;
};

/// Allocation of the driver.
struct MemoryBlock {
    VkDeviceMemory memory = VK_NULL_HANDLE;
    std::uint32_t type = 0;
    std::uint64_t n_bytes = 0;
    std::byte* mapped = nullptr;  ///< Host address, if the host uses the block.
    FreeRanges free;
};

/// Part of a block that belongs to a buffer.
struct MemoryPiece {
    MemoryBlock* block = nullptr;
    std::uint64_t offset = 0;
    std::uint64_t n_bytes = 0;
};

/// All memory of a device. Thread-safe.
class MemoryPools {
public:
    static constexpr std::uint64_t kBlockBytes = std::uint64_t(64) << 20;

    MemoryPools(VkPhysicalDevice physical, VkDevice device);
    ~MemoryPools();
    MemoryPools(const MemoryPools&) = delete;
    MemoryPools& operator=(const MemoryPools&) = delete;

    /// Allocates memory for a buffer.
    /// @param piece output: the memory, set if the result is VK_SUCCESS
    /// @return result of the driver for the last memory type that was tried
    VkResult take(const VkMemoryRequirements& needs, MemoryUse use, MemoryPiece& piece);
    void release(const MemoryPiece& piece);
    std::size_t n_blocks() const;

private:
    using Blocks = std::vector<std::unique_ptr<MemoryBlock>>;

    VkDevice device_;
    VkPhysicalDeviceMemoryProperties properties_{};
    mutable std::mutex mutex_;
    std::array<Blocks, VK_MAX_MEMORY_TYPES> blocks_;  ///< Blocks of each memory type.

    std::vector<std::uint32_t> types(const VkMemoryRequirements& needs, MemoryUse use) const;
    std::uint64_t shared_bytes(std::uint32_t type) const;
    bool allocate_of_type(const VkMemoryRequirements& needs, std::uint32_t type, MemoryPiece& piece);
    VkResult grow(const VkMemoryRequirements& needs, std::uint32_t type, MemoryPiece& piece);
    VkResult map(MemoryBlock& block);
    VkResult add_block(std::uint32_t type, std::uint64_t n_bytes);
    void release_empty(std::uint32_t type, std::size_t n_kept);
};

}  // namespace relidar::gpu
