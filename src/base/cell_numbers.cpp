// SPDX-License-Identifier: Apache-2.0
// Numbers the grid cells that contain items, in parallel. Keys are divided into parts by
// their hash, and each part has a separate hash table. Each part processes its items in
// order, so that it finds the first item of each cell. Cells are then numbered by the
// order of their first items.
#include "base/cell_numbers.hpp"

#include <array>
#include <numeric>
#include <unordered_map>

#include "base/random.hpp"

namespace relidar {
namespace {

constexpr std::size_t kParts = 32;
// Number of items that one parallel task processes.
constexpr std::size_t kItemsPerBlock = 1 << 16;

/// Indices of the items of one block, divided into kParts lists by the hash of their
/// keys.
using ItemsByPart = std::array<std::vector<std::uint32_t>, kParts>;

std::vector<ItemsByPart> partition_items_by_key(std::span<const std::uint64_t> key) {
    std::vector<ItemsByPart> blocks((key.size() + kItemsPerBlock - 1) / kItemsPerBlock);
    parallel_for(static_cast<int>(blocks.size()), [&](int s) {
        const std::size_t begin = std::size_t(s) * kItemsPerBlock;
        for (std::size_t i = begin; i < std::min(key.size(), begin + kItemsPerBlock); ++i)
            blocks[std::size_t(s)][combine_hashes(key[i]) % kParts].push_back(static_cast<std::uint32_t>(i));
    });
    return blocks;
}

}  // namespace

CellNumbers assign_cell_numbers(std::span<const std::uint64_t> key) {
    const std::vector<ItemsByPart> blocks = partition_items_by_key(key);
    CellNumbers numbers{std::vector<std::uint32_t>(key.size()), 0};
    // First stores, for each item, the index of the first item in the same cell. At the
    // end, this index is replaced by the number of the cell.
    std::vector<std::uint32_t>& first = numbers.of;
    parallel_for(kParts, [&](int part) {
        std::unordered_map<std::uint64_t, std::uint32_t> table;
        for (const ItemsByPart& items : blocks)
            for (const std::uint32_t i : items[std::size_t(part)])
                first[i] = table.try_emplace(key[i], i).first->second;
    });
    std::vector<std::uint32_t> number(key.size());
    for (std::uint32_t i = 0; i < key.size(); ++i)
        if (first[i] == i) number[i] = static_cast<std::uint32_t>(numbers.n_cells++);
    for_each_block(key.size(), [&](std::size_t index) { numbers.of[index] = number[first[index]]; });
    return numbers;
}

ItemsOfCells::ItemsOfCells(const CellNumbers& numbers)
    : first_(numbers.n_cells + 1, 0), items_(numbers.of.size()) {
    for (const std::uint32_t cell : numbers.of) ++first_[cell + 1u];
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    for (std::uint32_t i = 0; i < numbers.of.size(); ++i) items_[next[numbers.of[i]]++] = i;
}

}  // namespace relidar
