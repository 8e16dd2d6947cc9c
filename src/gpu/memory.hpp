// SPDX-License-Identifier: Apache-2.0
// Allocates device memory in blocks that many buffers share. A driver may allow only 4096
// allocations (maxMemoryAllocationCount), and each allocation needs a slow system call.
// An array larger than half a block gets a separate block. (The Vulkan Memory Allocator
// library also does this, but Debian 12 has no package of it.)
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

/// All buffers except `device` stay mapped and are host-coherent.
enum class BufferPurpose {
    device,  ///< Arrays that kernels read and write.
    parameters,
    upload,  ///< Staging memory that the host writes and copy commands read.
    readback,
};

struct MemoryBudget {
    std::uint64_t n_bytes = 0;  ///< Budget of the largest device-local heap, in bytes.
    std::uint64_t n_used = 0;   ///< Memory of this heap that this process uses, in bytes.

    std::uint64_t free_bytes() const { return n_bytes > n_used ? n_bytes - n_used : 0; }
};
/// Returns the size and the use of the largest heap of device memory. With
/// VK_EXT_memory_budget, memory of other programs is subtracted. Otherwise n_used is 0.
MemoryBudget query_budget(VkPhysicalDevice physical);

class FreeRanges {
public:
    explicit FreeRanges(std::uint64_t n_bytes) : n_bytes_(n_bytes), ranges_{{0, n_bytes}} {}
    /// First fit.
    /// @param alignment a power of two
    std::optional<std::uint64_t> allocate_range(std::uint64_t n_bytes, std::uint64_t alignment);
    void release_range(std::uint64_t offset, std::uint64_t n_bytes);
    bool is_all_free() const { return ranges_.size() == 1 && ranges_.begin()->second == n_bytes_; }

private:
    std::uint64_t n_bytes_;
    /// Free ranges: map from offset to size, in bytes. Adjacent free ranges are merged.
    std::map<std::uint64_t, std::uint64_t> ranges_;
};

struct MemoryBlock {
    VkDeviceMemory memory = VK_NULL_HANDLE;
    std::uint32_t type = 0;
    std::uint64_t n_bytes = 0;
    std::byte* mapped = nullptr;  ///< Host address of the block. Null if the block is not mapped.
    FreeRanges free;
    bool exports = false;            ///< Can be exported to CUDA or HIP.
    std::shared_ptr<void> imported;  ///< The block as CUDA or HIP knows it, after its first import.
};

struct MemorySuballocation {
    MemoryBlock* block = nullptr;
    std::uint64_t offset = 0;
    std::uint64_t n_bytes = 0;
};

class DeviceMemoryAllocator {
public:
    static constexpr std::uint64_t kBlockBytes = std::uint64_t(64) << 20;

    /// @param map_arrays maps memory of arrays too, if the host can address it
    /// @param export_arrays allocates arrays such that CUDA or HIP can import them
    DeviceMemoryAllocator(VkPhysicalDevice physical, VkDevice device, bool map_arrays, bool export_arrays);
    ~DeviceMemoryAllocator();

    VkResult suballocate(const VkMemoryRequirements& requirements, BufferPurpose purpose,
                         MemorySuballocation& result);
    void release(const MemorySuballocation& result);
    std::size_t block_count() const;

private:
    using MemoryBlockList = std::vector<std::unique_ptr<MemoryBlock>>;

    VkDevice device_;
    bool map_arrays_, export_arrays_;
    VkPhysicalDeviceMemoryProperties properties_{};
    mutable std::mutex mutex_;
    std::array<MemoryBlockList, VK_MAX_MEMORY_TYPES> blocks_;  ///< Memory blocks, indexed by memory type.

    std::vector<std::uint32_t> find_types(const VkMemoryRequirements& requirements,
                                          BufferPurpose purpose) const;
    std::uint64_t new_block_bytes(std::uint32_t type) const;
    std::optional<MemorySuballocation> place_in_block(const VkMemoryRequirements& requirements,
                                                      std::uint32_t type, bool exports);
    VkResult place_in_new_block(const VkMemoryRequirements& requirements, std::uint32_t type, bool exports,
                                std::optional<MemorySuballocation>& result);
    VkResult map_block(MemoryBlock& block);
    VkResult allocate_block(std::uint32_t type, std::uint64_t n_bytes, bool exports);
    void release_empty(std::uint32_t type, std::size_t n_blocks_to_keep);
};

}  // namespace relidar::gpu
