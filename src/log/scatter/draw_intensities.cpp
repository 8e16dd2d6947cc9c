// SPDX-License-Identifier: Apache-2.0
// Draws an intensity for each ray: walks down the tree and picks a random value of its
// leaf. The features use intensities that were drawn before, along the beam and above.
// Rows are drawn concurrently. Each row stays so far behind the row above that all needed
// values exist. The result is the same as for sequential rows.
#include <relidar/log/scatter.hpp>

#include <algorithm>
#include <atomic>
#include <thread>

#include "base/assert.hpp"
#include "base/parallel.hpp"
#include "base/random.hpp"
#include "log/scatter/context.hpp"

namespace relidar {
namespace {

constexpr int kColumnsTogether = 64;  // columns between two checks of the row above

const IntensityScatter::Node& leaf_of(const IntensityScatter& scatter, const scatter_detail::Context& context,
                                      int row, int column) {
    const IntensityScatter::Node* node = &scatter.nodes.front();
    while (node->feature >= 0) {
        const float asked = context.feature(std::size_t(node->feature), row, column);
        node = &scatter.nodes[std::size_t(node->child) + (asked <= node->at ? 0 : 1)];
    }
    return *node;
}

}  // namespace

std::size_t count_scatter_features() { return scatter_detail::kFeatures; }

std::vector<float> draw_intensities(const IntensityScatter& scatter, const RenderedIntensities& rendered,
                                    std::span<const std::uint8_t> returns, std::uint64_t seed) {
    RELIDAR_ASSERT_EQ(returns.size(), std::size_t(rendered.rows) * std::size_t(rendered.columns));
    std::vector<float> drawn(returns.size(), kNoIntensity);
    const scatter_detail::Context context(rendered, drawn);
    // Number of drawn columns of each row.
    std::vector<std::atomic<int>> drawn_columns(static_cast<std::size_t>(rendered.rows));
    run_parallel(rendered.rows, [&](int row) {
        for (int first = 0; first < rendered.columns; first += kColumnsTogether) {
            const int end = std::min(first + kColumnsTogether, rendered.columns);
            const int needed = std::min(end + scatter_detail::kAhead, rendered.columns);
            while (row > 0 && drawn_columns[std::size_t(row) - 1].load(std::memory_order_acquire) < needed)
                std::this_thread::yield();
            for (int column = first; column < end; ++column) {
                const auto i = std::size_t(row) * std::size_t(rendered.columns) + std::size_t(column);
                if (returns[i] == 0) continue;
                const IntensityScatter::Node& leaf = leaf_of(scatter, context, row, column);
                drawn[i] = scatter.values[leaf.first + std::size_t(Random(hash64(seed, i)).uniform() *
                                                                   double(leaf.count))];
            }
            drawn_columns[std::size_t(row)].store(end, std::memory_order_release);
        }
    });
    return drawn;
}

}  // namespace relidar
