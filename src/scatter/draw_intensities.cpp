// SPDX-License-Identifier: Apache-2.0
// Each ray goes down the tree and takes one of the intensities of its leaf.
#include <relidar/scatter.hpp>

#include "core/assert.hpp"
#include "core/random.hpp"
#include "scatter/context.hpp"

namespace relidar {
namespace {

const IntensityScatter::Node& leaf_of(const IntensityScatter& scatter, const scatter_detail::Context& context, int row, int column) {
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
    for (std::size_t i = 0; i < drawn.size(); ++i) {
        if (returns[i] == 0) continue;
        const auto columns = std::size_t(rendered.columns);
        const IntensityScatter::Node& leaf = leaf_of(scatter, context, int(i / columns), int(i % columns));
        drawn[i] = scatter.values[leaf.first + std::size_t(Random(hash64(seed, i)).uniform() * double(leaf.count))];
    }
    return drawn;
}

}  // namespace relidar
