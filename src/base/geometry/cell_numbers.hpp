// SPDX-License-Identifier: Apache-2.0
// Numbers the grid cells that contain items, in parallel.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/parallel.hpp"

namespace relidar {

/// Cells are numbered in the order of their first items, for any number of threads.
struct ItemCellIndices {
    std::vector<std::uint32_t> of;  ///< Cell number of each item, [items].
    std::size_t n_cells = 0;
};
ItemCellIndices number_cells(std::span<const std::uint64_t> cell_key_per_item);
template <class KeyOf>
ItemCellIndices number_cells(std::size_t n_items, const KeyOf& key_of) {
    std::vector<std::uint64_t> keys(n_items);
    parallel_blocks(n_items, [&](std::size_t index) { keys[index] = key_of(index); });
    return number_cells(keys);
}

class CellItemLists {
public:
    explicit CellItemLists(const ItemCellIndices& numbers);

    std::size_t size() const { return first_.size() - 1; }
    std::span<const std::uint32_t> items_of(std::size_t cell_number) const {
        return std::span(items_).subspan(first_[cell_number], first_[cell_number + 1] - first_[cell_number]);
    }

private:
    // [cells + 1] index in items_ of the first item of each cell.
    std::vector<std::size_t> first_;
    std::vector<std::uint32_t> items_;
};

}  // namespace relidar
