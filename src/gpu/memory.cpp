// SPDX-License-Identifier: Apache-2.0
#include "gpu/memory.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>

#include "gpu/context.hpp"

namespace relidar::gpu {

namespace {

// Acceleration structures need this alignment in bytes.
constexpr std::uint64_t kBufferAlignment = 256;

/// Returns the memory properties to request for a purpose, best first. Parameters prefer
/// memory on the device, and downloads prefer cached memory, which the host reads fast.
std::vector<VkMemoryPropertyFlags> preferred_flags(BufferPurpose purpose) {
    constexpr VkMemoryPropertyFlags kHostFlags =
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    if (purpose == BufferPurpose::device) return {VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT};
    if (purpose == BufferPurpose::parameters)
        return {kHostFlags | VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT, kHostFlags};
    if (purpose == BufferPurpose::upload) return {kHostFlags};
    if (purpose == BufferPurpose::readback)
        return {kHostFlags | VK_MEMORY_PROPERTY_HOST_CACHED_BIT, kHostFlags};
    return {};
}

}  // namespace

MemoryBudget query_budget(VkPhysicalDevice physical) {
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
        // Keeps the largest heap in device memory.
        if ((heap.flags & VK_MEMORY_HEAP_DEVICE_LOCAL_BIT) && heap_budget.n_bytes >= largest.n_bytes)
            largest = heap_budget;
    }
    return largest;
}

/// Takes space from the first free range that is large enough. The parts of the range
/// before and behind this space stay free.
/// @return offset in bytes, or nullopt if no range is large enough
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

/// Returns a range to the free list and merges it with adjacent free ranges, so that
/// large arrays can use the space again.
void FreeRanges::release_range(std::uint64_t offset, std::uint64_t n_bytes) {
    // `ranges_` maps the offset of each free range to its size.
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

DeviceMemoryAllocator::DeviceMemoryAllocator(VkPhysicalDevice physical, VkDevice device, bool map_arrays,
                                             bool export_arrays)
    : device_(device), map_arrays_(map_arrays), export_arrays_(export_arrays) {
    vkGetPhysicalDeviceMemoryProperties(physical, &properties_);
}

DeviceMemoryAllocator::~DeviceMemoryAllocator() {
    for (std::uint32_t type = 0; type < VK_MAX_MEMORY_TYPES; ++type) release_empty(type, 0);
}

/// Returns the size of new blocks of a memory type. It is smaller for a small heap, for
/// example the 256 MiB that a host can access.
std::uint64_t DeviceMemoryAllocator::new_block_bytes(std::uint32_t type) const {
    const std::uint64_t heap_bytes = properties_.memoryHeaps[properties_.memoryTypes[type].heapIndex].size;
    // Drivers without hardware report a heap size of 0.
    return heap_bytes ? std::min(kBlockBytes, heap_bytes / 16) : kBlockBytes;
}

/// Returns the memory types to try for a buffer, best first: at most one for each list of
/// preferred flags. Device memory that the host can access may be scarce, so only small
/// parameter buffers may use it.
std::vector<std::uint32_t> DeviceMemoryAllocator::find_types(const VkMemoryRequirements& requirements,
                                                             BufferPurpose purpose) const {
    std::vector<std::uint32_t> suitable_types;
    for (const VkMemoryPropertyFlags flags : preferred_flags(purpose))
        for (std::uint32_t type = 0; type < properties_.memoryTypeCount; ++type) {
            const bool is_allowed = requirements.memoryTypeBits >> type & 1u;
            const bool has_flags = (properties_.memoryTypes[type].propertyFlags & flags) == flags;
            if (!is_allowed || !has_flags) continue;
            const bool is_too_large = purpose == BufferPurpose::parameters &&
                                      (flags & VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT) &&
                                      requirements.size > new_block_bytes(type);
            if (!is_too_large) suitable_types.push_back(type);
            break;  // Vulkan lists types from fast to slow, so the first one is enough.
        }
    return suitable_types;
}

/// Takes space in an existing block of a memory type.
/// @param exports true: only in blocks that other programs can import; false: in others
std::optional<MemorySuballocation> DeviceMemoryAllocator::place_in_block(
    const VkMemoryRequirements& requirements, std::uint32_t type, bool exports) {
    for (const std::unique_ptr<MemoryBlock>& block : blocks_[type])
        if (block->exports != exports) continue;
        else if (const auto offset = block->free.allocate_range(
                     requirements.size, std::max(requirements.alignment, kBufferAlignment)))
            return MemorySuballocation{block.get(), *offset, requirements.size};
    return std::nullopt;
}

/// Allocates memory of the best suitable type: in an existing block if one has space,
/// otherwise in a new block. Tries the next type if this fails.
VkResult DeviceMemoryAllocator::suballocate(const VkMemoryRequirements& requirements, BufferPurpose purpose,
                                            MemorySuballocation& suballocation) {
    const std::lock_guard lock(mutex_);
    const bool is_array = purpose == BufferPurpose::device;  // large, used by kernels only
    const bool exports = is_array && export_arrays_;         // other programs can use the memory
    VkResult result = VK_ERROR_FEATURE_NOT_PRESENT;          // Result if no memory type is suitable.
    for (const std::uint32_t type : find_types(requirements, purpose)) {
        std::optional<MemorySuballocation> free_piece = place_in_block(requirements, type, exports);
        result = free_piece ? VK_SUCCESS : place_in_new_block(requirements, type, exports, free_piece);
        if (result != VK_SUCCESS) continue;
        suballocation = *free_piece;
        // The host needs access to all buffers except arrays, and to arrays if possible.
        const bool is_host_visible =
            (properties_.memoryTypes[type].propertyFlags & VK_MEMORY_PROPERTY_HOST_COHERENT_BIT) != 0;
        const bool needs_mapping = !is_array || (map_arrays_ && is_host_visible);
        if (needs_mapping) result = map_block(*suballocation.block);
        if (result == VK_SUCCESS) break;
        suballocation.block->free.release_range(suballocation.offset, suballocation.n_bytes);
    }
    return result;
}

/// Allocates a block that several buffers can share, or a separate block for an array
/// larger than half a block. If this fails, tries to allocate only the required size.
VkResult DeviceMemoryAllocator::place_in_new_block(const VkMemoryRequirements& requirements,
                                                   std::uint32_t type, bool exports,
                                                   std::optional<MemorySuballocation>& suballocation) {
    const std::uint64_t shared_bytes = new_block_bytes(type);
    const bool needs_own_block = requirements.size > shared_bytes / 2;
    VkResult result = allocate_block(type, needs_own_block ? requirements.size : shared_bytes, exports);
    if (result != VK_SUCCESS) {
        release_empty(type, 0);  // empty blocks may occupy the memory
        result = allocate_block(type, requirements.size, exports);
    }
    if (result == VK_SUCCESS) suballocation = place_in_block(requirements, type, exports);
    return result;
}

/// Allocates a block of device memory from the driver.
/// @param exports true: other programs on the device can import the block
VkResult DeviceMemoryAllocator::allocate_block(std::uint32_t type, std::uint64_t n_bytes, bool exports) {
    VkExportMemoryAllocateInfo exported{VK_STRUCTURE_TYPE_EXPORT_MEMORY_ALLOCATE_INFO};
    exported.handleTypes = VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT;
    VkMemoryAllocateFlagsInfo flags{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_FLAGS_INFO};
    flags.flags = VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT;
    if (exports) flags.pNext = &exported;
    VkMemoryAllocateInfo info{VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO, &flags};
    info.allocationSize = n_bytes;
    info.memoryTypeIndex = type;
    auto block = std::make_unique<MemoryBlock>(MemoryBlock{
        .type = type, .n_bytes = n_bytes, .free = FreeRanges(n_bytes), .exports = exports, .imported = {}});
    const VkResult result = vkAllocateMemory(device_, &info, nullptr, &block->memory);
    if (result != VK_SUCCESS) return result;
    set_object_name(device_, VK_OBJECT_TYPE_DEVICE_MEMORY, block->memory,
                    fmt::format("block of {} MiB, type {}", n_bytes >> 20, type));
    blocks_[type].push_back(std::move(block));
    return result;
}

VkResult DeviceMemoryAllocator::map_block(MemoryBlock& block) {
    if (block.mapped) return VK_SUCCESS;
    void* pointer = nullptr;
    const VkResult result = vkMapMemory(device_, block.memory, 0, VK_WHOLE_SIZE, 0, &pointer);
    block.mapped = static_cast<std::byte*>(pointer);
    return result;
}

/// Keeps one empty block of each memory type for short-lived buffers.
void DeviceMemoryAllocator::release(const MemorySuballocation& result) {
    const std::lock_guard lock(mutex_);
    result.block->free.release_range(result.offset, result.n_bytes);
    if (result.block->free.is_all_free()) release_empty(result.block->type, 1);
}

/// Frees the empty blocks of a memory type.
/// @param n_blocks_to_keep number of empty blocks of normal size that are kept
void DeviceMemoryAllocator::release_empty(std::uint32_t type, std::size_t n_blocks_to_keep) {
    std::erase_if(blocks_[type], [&](const std::unique_ptr<MemoryBlock>& block) {
        if (!block->free.is_all_free()) return false;
        if (n_blocks_to_keep > 0 && block->n_bytes == new_block_bytes(type)) {
            --n_blocks_to_keep;
            return false;
        }
        block->imported.reset();  // CUDA or HIP must release the memory before it is freed
        vkFreeMemory(device_, block->memory, nullptr);
        return true;
    });
}

std::size_t DeviceMemoryAllocator::block_count() const {
    const std::lock_guard lock(mutex_);
    std::size_t n = 0;
    for (const MemoryBlockList& blocks : blocks_) n += blocks.size();
    return n;
}

}  // namespace relidar::gpu
