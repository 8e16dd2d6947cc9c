// SPDX-License-Identifier: Apache-2.0
// Keys are parted by their hash, so that each part has a table of its own. A part that
// meets its items in their order knows which was the first of a cell; the firsts of all
// parts, counted in the order of the items, are the numbers.
#include "base/cell_numbers.hpp"

#include <array>
#include <numeric>
#include <unordered_map>

#include "base/random.hpp"

namespace relidar {
namespace {

constexpr std::size_t kParts = 32;
constexpr std::size_t kStretch = 1 << 16;  // of items, which are shared out to the parts together

/// Items of a stretch, by part.
using Shared = std::array<std::vector<std::uint32_t>, kParts>;

std::vector<Shared> share_out(std::span<const std::uint64_t> key) {
    std::vector<Shared> stretches((key.size() + kStretch - 1) / kStretch);
    parallel_for(static_cast<int>(stretches.size()), [&](int s) {
        const std::size_t begin = std::size_t(s) * kStretch;
        for (std::size_t i = begin; i < std::min(key.size(), begin + kStretch); ++i)
            stretches[std::size_t(s)][hash64(key[i]) % kParts].push_back(static_cast<std::uint32_t>(i));
    });
    return stretches;
}

}  // namespace

CellNumbers number_cells(std::span<const std::uint64_t> key) {
    const std::vector<Shared> stretches = share_out(key);
    CellNumbers numbers{std::vector<std::uint32_t>(key.size()), 0};
    std::vector<std::uint32_t>& first = numbers.of;  // of the item's cell; then its number
    parallel_for(kParts, [&](int part) {
        std::unordered_map<std::uint64_t, std::uint32_t> table;
        for (const Shared& stretch : stretches)
            for (const std::uint32_t i : stretch[std::size_t(part)])
                first[i] = table.try_emplace(key[i], i).first->second;
    });
    std::vector<std::uint32_t> number(key.size());
    for (std::uint32_t i = 0; i < key.size(); ++i)
        if (first[i] == i) number[i] = static_cast<std::uint32_t>(numbers.n_cells++);
    for_each_block(key.size(), [&](std::size_t i) { numbers.of[i] = number[first[i]]; });
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
