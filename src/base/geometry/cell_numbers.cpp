// SPDX-License-Identifier: Apache-2.0
// Numbers the grid cells that contain items, in parallel. Keys are divided into parts by
// their hash, and each part has a separate hash table. Each part processes its items in
// order, so that it finds the first item of each cell.
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
/// Returns the parts of each block of kItemsPerBlock items, which one thread divides.
std::vector<ItemIndicesByPart> partition_by_hash(std::span<const std::uint64_t> cell_key_per_item) {
    std::vector<ItemIndicesByPart> blocks((cell_key_per_item.size() + kItemsPerBlock - 1) / kItemsPerBlock);
    parallel_for(static_cast<int>(blocks.size()), [&](int block) {
        const std::size_t begin = std::size_t(block) * kItemsPerBlock;
        const std::size_t end = std::min(cell_key_per_item.size(), begin + kItemsPerBlock);
        for (std::size_t item = begin; item < end; ++item) {
            const std::size_t part = hash_integer(cell_key_per_item[item]) % kHashParts;
            blocks[std::size_t(block)][part].push_back(static_cast<std::uint32_t>(item));
        }
    });
    return blocks;
}

/// Returns, for each item, the index of the first item with the same key.
std::vector<std::uint32_t> find_first_items(std::span<const std::uint64_t> cell_key_per_item) {
    const std::vector<ItemIndicesByPart> blocks = partition_by_hash(cell_key_per_item);
    std::vector<std::uint32_t> first_items(cell_key_per_item.size());
    parallel_for(kHashParts, [&](int part) {
        std::unordered_map<std::uint64_t, std::uint32_t> first_item_of_key;
        for (const ItemIndicesByPart& parts : blocks)
            for (const std::uint32_t item : parts[std::size_t(part)])
                // Items ascend within a part, so try_emplace() keeps the first of a key.
                first_items[item] =
                    first_item_of_key.try_emplace(cell_key_per_item[item], item).first->second;
    });
    return first_items;
}

}  // namespace

/// Gives equal keys the same cell number, in the order in which the keys first occur.
ItemCellIndices number_cells(std::span<const std::uint64_t> cell_key_per_item) {
    // For each item, the first item with the same key, which can be the item itself.
    const std::vector<std::uint32_t> first_items = find_first_items(cell_key_per_item);
    ItemCellIndices cells;
    std::vector<std::uint32_t> cell_of_first_item(first_items.size());
    for (std::uint32_t item = 0; item < first_items.size(); ++item)
        if (first_items[item] == item) cell_of_first_item[item] = static_cast<std::uint32_t>(cells.n_cells++);
    cells.of.resize(first_items.size());
    parallel_blocks(first_items.size(),
                    [&](std::size_t item) { cells.of[item] = cell_of_first_item[first_items[item]]; });
    return cells;
}

/// Lists the items of each cell in ascending order (counting sort).
CellItemLists::CellItemLists(const ItemCellIndices& cells)
    : first_(cells.n_cells + 1, 0), items_(cells.of.size()) {
    for (const std::uint32_t cell : cells.of) ++first_[cell + 1u];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    std::vector<std::size_t> next_place_of_cell(first_.begin(), first_.end() - 1);
    for (std::uint32_t item = 0; item < cells.of.size(); ++item)
        items_[next_place_of_cell[cells.of[item]]++] = item;
}

}  // namespace relidar
