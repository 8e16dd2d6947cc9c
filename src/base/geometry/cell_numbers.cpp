// SPDX-License-Identifier: Apache-2.0
// Numbers the grid cells that contain items, in parallel. Keys are divided into parts by
// their hash, and each part has a separate hash table. Each part processes its items in
// order, so that it finds the first item of each cell. Cells are then numbered by the
// order of their first items.
#include "base/geometry/cell_numbers.hpp"

#include <array>
#include <numeric>
#include <unordered_map>

#include "base/random.hpp"

namespace relidar {
namespace {

constexpr std::size_t kHashParts = 32;
constexpr std::size_t kItemsPerBlock = 1 << 16;

using ItemIndicesByPart = std::array<std::vector<std::uint32_t>, kHashParts>;

/// Divides the items by the hash of their keys, so that equal keys are in the same part.
std::vector<ItemIndicesByPart> partition_by_hash(std::span<const std::uint64_t> cell_key_per_item) {
    std::vector<ItemIndicesByPart> blocks((cell_key_per_item.size() + kItemsPerBlock - 1) / kItemsPerBlock);
    parallel_for(static_cast<int>(blocks.size()), [&](int s) {
        const std::size_t begin = std::size_t(s) * kItemsPerBlock;
        for (std::size_t i = begin; i < std::min(cell_key_per_item.size(), begin + kItemsPerBlock); ++i)
            blocks[std::size_t(s)][hash_integer(cell_key_per_item[i]) % kHashParts].push_back(
                static_cast<std::uint32_t>(i));
    });
    return blocks;
}

}  // namespace

ItemCellIndices number_cells(std::span<const std::uint64_t> cell_key_per_item) {
    const std::vector<ItemIndicesByPart> blocks = partition_by_hash(cell_key_per_item);
    ItemCellIndices numbers{std::vector<std::uint32_t>(cell_key_per_item.size()), 0};
    // `first` is the result array. The first loop stores, for each item, the index of the
    // first item in the same cell. The last loop replaces these indices by cell numbers.
    std::vector<std::uint32_t>& first = numbers.of;
    parallel_for(kHashParts, [&](int part) {
        std::unordered_map<std::uint64_t, std::uint32_t> table;
        for (const ItemIndicesByPart& items : blocks)
            for (const std::uint32_t i : items[std::size_t(part)])
                first[i] = table.try_emplace(cell_key_per_item[i], i).first->second;
    });
    std::vector<std::uint32_t> number(cell_key_per_item.size());
    for (std::uint32_t i = 0; i < cell_key_per_item.size(); ++i)
        if (first[i] == i) number[i] = static_cast<std::uint32_t>(numbers.n_cells++);
    parallel_blocks(cell_key_per_item.size(),
                    [&](std::size_t index) { numbers.of[index] = number[first[index]]; });
    return numbers;
}

CellItemLists::CellItemLists(const ItemCellIndices& numbers)
    : first_(numbers.n_cells + 1, 0), items_(numbers.of.size()) {
    for (const std::uint32_t cell : numbers.of) ++first_[cell + 1u];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (std::uint32_t i = 0; i < numbers.of.size(); ++i) items_[next[numbers.of[i]]++] = i;
}

}  // namespace relidar
