// SPDX-License-Identifier: Apache-2.0
// Assigns consecutive numbers to the grid cells that contain items, and lists the items
// of each cell. Runs on all cores.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/parallel.hpp"

namespace relidar {

/// For each item, the number of the grid cell that contains it. Cells are numbered in the
/// order of their first items, so the numbers do not depend on the number of threads.
struct CellNumbers {
    std::vector<std::uint32_t> of;  ///< Cell number of each item, [items].
    std::size_t n_cells = 0;
};
/// Numbers the grid cells that contain items: 0, 1, 2, ...
/// @param key [items] key of the grid cell that contains each item
CellNumbers assign_cell_numbers(std::span<const std::uint64_t> key);
/// Numbers the grid cells that contain items: 0, 1, 2, ...
/// @param count number of items
/// @param key_of function that returns the key of an item's grid cell
template <class KeyOf>
CellNumbers assign_cell_numbers(std::size_t count, const KeyOf& key_of) {
    std::vector<std::uint64_t> keys(count);
    for_each_block(count, [&](std::size_t index) { keys[index] = key_of(index); });
    return assign_cell_numbers(keys);
}

/// Lists the items of each cell in ascending order.
class ItemsOfCells {
public:
    explicit ItemsOfCells(const CellNumbers& numbers);

    std::size_t size() const { return first_.size() - 1; }
    std::span<const std::uint32_t> of(std::size_t cell) const {
        return std::span(items_).subspan(first_[cell], first_[cell + 1] - first_[cell]);
    }

private:
    // [cells + 1] index in items_ of the first item of each cell.
    std::vector<std::size_t> first_;
    std::vector<std::uint32_t> items_;
};

}  // namespace relidar
