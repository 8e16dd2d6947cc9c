// SPDX-License-Identifier: Apache-2.0
// Allocates device memory in blocks. Inside a block, a buffer gets the first free range
// that is large enough.
#include "gpu/memory.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>

#include "gpu/context.hpp"

namespace relidar::gpu {

namespace {

// Alignment of all buffers in bytes. Acceleration structures need this alignment. All
// other buffers need less.
constexpr std::uint64_t kAlignment = 256;

/// Returns the memory properties to request, best first.
std::vector<VkMemoryPropertyFlags> list_preferred_memory_flags(BufferPurpose use) {
    constexpr VkMemoryPropertyFlags kHost =
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    switch (use) {
        case BufferPurpose::device:
            return {VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
        case BufferPurpose::parameters:
            return {kHost | VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, kHost};
        case BufferPurpose::upload:
            return {kHost};
        case BufferPurpose::readback:
            return {kHost | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, kHost};
    }
    return {};
}

}  // namespace

MemoryBudget query_memory_budget(VkPhysicalDevice physical) {
    VkPhysicalDeviceMemoryBudgetPropertiesEXT budgets{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_BUDGET_PROPERTIES_EXT};
    VkPhysicalDeviceMemoryProperties2 memory{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_MEMORY_PROPERTIES_2};
    const bool has_budgets = has_extension(physical, VK_EXT_MEMORY_BUDGET_EXTENSION_NAME);
    if (has_budgets) memory.pNext = &budgets;
    vkGetPhysicalDeviceMemoryProperties2(physical, &memory);
    MemoryBudget largest;
    for (std::uint32_t i = 0; i < memory.memoryProperties.memoryHeapCount; ++i) {
        const VkMemoryHeap& heap = memory.memoryProperties.memoryHeaps[i];
        const MemoryBudget heap_budget{has_budgets ? budgets.heapBudget[i] : heap.size,
                                       has_budgets ? budgets.heapUsage[i] : 0};
        if ((heap.flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) && heap_budget.n_bytes >= largest.n_bytes)
            largest = heap_budget;
    }
    return largest;
}

std::optional<std::uint64_t> FreeRanges::allocate_range(std::uint64_t n_bytes, std::uint64_t alignment) {
    for (auto range = ranges_.begin(); range != ranges_.end(); ++range) {
        const auto [begin, size] = *range;
        const std::uint64_t offset = (begin + alignment - 1) / alignment * alignment, end = begin + size;
        if (offset > end || end - offset < n_bytes) continue;
        ranges_.erase(range);
        if (offset > begin) ranges_[begin] = offset - begin;
        if (offset + n_bytes < end) ranges_[offset + n_bytes] = end - offset - n_bytes;
        return offset;
    }
    return std::nullopt;
}

void FreeRanges::release_range(std::uint64_t offset, std::uint64_t n_bytes) {
    const auto next = ranges_.lower_bound(offset);
    if (next != ranges_.end() && next->first == offset + n_bytes) {
        n_bytes += next->second;
        ranges_.erase(next);
    }
    const auto after = ranges_.lower_bound(offset);
    if (after != ranges_.begin()) {
        const auto before = std::prev(after);
        if (before->first + before->second == offset) {
            before->second += n_bytes;
            return;
        }
    }
    ranges_[offset] = n_bytes;
}

DeviceMemoryAllocator::DeviceMemoryAllocator(VkPhysicalDevice physical, VkDevice device) : device_(device) {
    vkGetPhysicalDeviceMemoryProperties(physical, &properties_);
}

DeviceMemoryAllocator::~DeviceMemoryAllocator() {
    for (std::uint32_t type = 0; type < VK_MAX_MEMORY_TYPES; ++type) release_empty_blocks(type, 0);
}

/// Returns the size of a memory block that several buffers share. It is smaller for a
/// small heap. For example, a heap has 256 MiB if the host can access only a part of the
/// device memory.
std::uint64_t DeviceMemoryAllocator::get_shared_block_bytes(std::uint32_t memory_type) const {
    const std::uint64_t heap_bytes =
        properties_.memoryHeaps[properties_.memoryTypes[memory_type].heapIndex].size;
    // Drivers without hardware report a heap size of 0.
    return heap_bytes ? std::min(kBlockBytes, heap_bytes / 16) : kBlockBytes;
}

/// Returns the memory types that satisfy the requirements, best first. Device memory that
/// the host can access may be scarce. Therefore only small parameter buffers may use it.
std::vector<std::uint32_t> DeviceMemoryAllocator::list_memory_types(const VkMemoryRequirements& needs,
                                                                    BufferPurpose use) const {
    std::vector<std::uint32_t> suitable_types;
    for (const VkMemoryPropertyFlags properties_mask : list_preferred_memory_flags(use))
        for (std::uint32_t type = 0; type < properties_.memoryTypeCount; ++type) {
            if (!(needs.memoryTypeBits >> type & 1u) ||
                (properties_.memoryTypes[type].propertyFlags & properties_mask) != properties_mask)
                continue;
            const bool scarce = use == BufferPurpose::parameters &&
                                (properties_mask & VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT) &&
                                needs.size > get_shared_block_bytes(type);
            if (!scarce) suitable_types.push_back(type);
            break;
        }
    return suitable_types;
}

/// Allocates memory from an existing block of this type. Returns nothing if no block has
/// enough space.
std::optional<MemorySuballocation> DeviceMemoryAllocator::allocate_from_existing_block(
    const VkMemoryRequirements& needs, std::uint32_t memory_type) {
    for (const std::unique_ptr<MemoryBlock>& block : blocks_[memory_type])
        if (const auto offset = block->free.allocate_range(needs.size, std::max(needs.alignment, kAlignment)))
            return MemorySuballocation{block.get(), *offset, needs.size};
    return std::nullopt;
}

VkResult DeviceMemoryAllocator::allocate_piece(const VkMemoryRequirements& needs, BufferPurpose use,
                                               MemorySuballocation& piece) {
    const std::lock_guard lock(mutex_);
    VkResult result = VK_ERROR_FEATURE_NOT_PRESENT;  // Result if no memory type is suitable.
    for (const std::uint32_t type : list_memory_types(needs, use)) {
        std::optional<MemorySuballocation> free_piece = allocate_from_existing_block(needs, type);
        result = free_piece ? VK_SUCCESS : allocate_from_new_block(needs, type, free_piece);
        if (result != VK_SUCCESS) continue;
        piece = *free_piece;
        if (use != BufferPurpose::device) result = map_block(*piece.block);
        if (result == VK_SUCCESS) break;
        piece.block->free.release_range(piece.offset, piece.n_bytes);
    }
    return result;
}

VkResult DeviceMemoryAllocator::allocate_from_new_block(const VkMemoryRequirements& needs,
                                                        std::uint32_t memory_type,
                                                        std::optional<MemorySuballocation>& piece) {
    const std::uint64_t shared = get_shared_block_bytes(memory_type);
    VkResult result = VK_SUCCESS;
    // Tries to allocate a block that several buffers can share. If this fails, tries to
    // allocate only the required size.
    for (const std::uint64_t n_bytes : {needs.size > shared / 2 ? needs.size : shared, needs.size}) {
        result = add_block(memory_type, n_bytes);
        if (result == VK_SUCCESS && (piece = allocate_from_existing_block(needs, memory_type)))
            return VK_SUCCESS;
        release_empty_blocks(memory_type, 0);
    }
    return result;
}

VkResult DeviceMemoryAllocator::add_block(std::uint32_t memory_type, std::uint64_t n_bytes) {
    VkMemoryAllocateFlagsInfo flags{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO};
    flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
    VkMemoryAllocateInfo info{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, &flags};
    info.allocationSize = n_bytes;
    info.memoryTypeIndex = memory_type;
    auto block = std::make_unique<MemoryBlock>(
        MemoryBlock{VK_NULL_HANDLE, memory_type, n_bytes, nullptr, FreeRanges(n_bytes)});
    const VkResult result = vkAllocateMemory(device_, &info, nullptr, &block->memory);
    if (result != VK_SUCCESS) return result;
    set_object_name(device_, VK_OBJECT_TYPE_DEVICE_MEMORY, block->memory,
                    fmt::format("block of {} MiB, type {}", n_bytes >> 20, memory_type));
    blocks_[memory_type].push_back(std::move(block));
    return result;
}

VkResult DeviceMemoryAllocator::map_block(MemoryBlock& block) {
    if (block.mapped) return VK_SUCCESS;
    void* pointer = nullptr;
    const VkResult result = vkMapMemory(device_, block.memory, 0, VK_WHOLE_SIZE, 0, &pointer);
    block.mapped = static_cast<std::byte*>(pointer);
    return result;
}

/// Releases the memory of a buffer. Keeps one empty block of each memory type. Otherwise
/// short-lived buffers would repeatedly allocate and free the same block.
void DeviceMemoryAllocator::release_piece(const MemorySuballocation& piece) {
    const std::lock_guard lock(mutex_);
    piece.block->free.release_range(piece.offset, piece.n_bytes);
    if (piece.block->free.is_fully_free()) release_empty_blocks(piece.block->type, 1);
}

/// Frees the empty memory blocks of a memory type.
/// @param n_kept number of empty blocks of normal size that are kept
void DeviceMemoryAllocator::release_empty_blocks(std::uint32_t memory_type, std::size_t n_kept) {
    std::erase_if(blocks_[memory_type], [&](const std::unique_ptr<MemoryBlock>& block) {
        if (!block->free.is_fully_free()) return false;
        if (n_kept > 0 && block->n_bytes == get_shared_block_bytes(memory_type)) {
            --n_kept;
            return false;
        }
        vkFreeMemory(device_, block->memory, nullptr);
        return true;
    });
}

std::size_t DeviceMemoryAllocator::count_blocks() const {
    const std::lock_guard lock(mutex_);
    std::size_t n = 0;
    for (const MemoryBlockList& blocks : blocks_) n += blocks.size();
    return n;
}

}  // namespace relidar::gpu
