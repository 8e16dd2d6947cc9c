// SPDX-License-Identifier: Apache-2.0
// Numbers for the cells that items lie in, and the items of each cell, on all cores.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/parallel.hpp"

namespace relidar {

/// Cells in the order in which items first name them, whatever the number of cores.
struct CellNumbers {
    std::vector<std::uint32_t> of;  ///< [items]
    std::size_t n_cells = 0;
};
/// @param key [items] of the cell that an item lies in
CellNumbers number_cells(std::span<const std::uint64_t> key);
/// @param key_of  (item) -> the key of its cell
template <class KeyOf>
CellNumbers number_cells(std::size_t n, const KeyOf& key_of) {
    std::vector<std::uint64_t> keys(n);
    for_each_block(n, [&](std::size_t i) { keys[i] = key_of(i); });
    return number_cells(keys);
}

/// The items of each cell, ascending.
class ItemsOfCells {
public:
    explicit ItemsOfCells(const CellNumbers& numbers);

    std::size_t size() const { return first_.size() - 1; }
    std::span<const std::uint32_t> of(std::size_t cell) const {
        return std::span(items_).subspan(first_[cell], first_[cell + 1] - first_[cell]);
    }

private:
    std::vector<std::size_t> first_;  // [cells + 1] in items_
    std::vector<std::uint32_t> items_;
};

}  // namespace relidar
