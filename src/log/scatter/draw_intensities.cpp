// SPDX-License-Identifier: Apache-2.0
// Draws a random intensity for each ray from a leaf of a decision tree. The tree uses
// intensities that were already drawn for neighbours in the same row and in the rows
// above. The image is divided into tiles, and independent tiles are drawn in parallel.
// The result is the same as drawing one ray after the other, row by row.
#include <relidar/log/scatter.hpp>

#include <algorithm>

#include "base/assert.hpp"
#include "base/parallel.hpp"
#include "base/random.hpp"
#include "log/scatter/ray_features.hpp"

namespace relidar {
namespace {

constexpr int kTileColumns = 64;  // Number of columns of a tile. Each tile has one row.
/// Tile t of a row depends on tile t - 1 of this row and, in the rows above, on tiles up
/// to t + 1. Tiles with the same 2 * row + t are independent and run in parallel.
static_assert(scatter::kMaxColumnsAhead <= kTileColumns);

/// Returns the leaf of a ray: from the root, goes to the first child of a node if the
/// feature of the node is at most `at`, otherwise to the second. `child` is the first
/// child; the second one follows it. A leaf has a negative feature index.
const IntensityScatterModel::DecisionTreeNode& find_tree_leaf(
    const IntensityScatterModel& scatter, const scatter::RayFeatureExtractor& feature_extractor, int row,
    int column) {
    const IntensityScatterModel::DecisionTreeNode* node = &scatter.nodes.front();
    while (node->feature >= 0) {
        const float feature_value =
            feature_extractor.compute_feature(std::size_t(node->feature), row, column);
        node = &scatter.nodes[std::size_t(node->child) + (feature_value <= node->at ? 0 : 1)];
    }
    return *node;
}

}  // namespace

std::vector<float> draw_intensities(const IntensityScatterModel& scatter,
                                    const RenderedIntensityImage& rendered,
                                    std::span<const std::uint8_t> return_flags, std::uint64_t seed) {
    RELIDAR_ASSERT_EQ(return_flags.size(), std::size_t(rendered.rows) * std::size_t(rendered.columns));
    std::vector<float> drawn(return_flags.size(), kNoIntensity);
    // The features of a ray use the intensities that `drawn` has when the ray is drawn.
    const scatter::RayFeatureExtractor feature_extractor(rendered, drawn);
    const auto draw_tile = [&](int row, int tile) {
        const int end = std::min((tile + 1) * kTileColumns, rendered.columns);
        for (int column = tile * kTileColumns; column < end; ++column) {
            const auto i = std::size_t(row) * std::size_t(rendered.columns) + std::size_t(column);
            if (return_flags[i] == 0) continue;
            const IntensityScatterModel::DecisionTreeNode& leaf =
                find_tree_leaf(scatter, feature_extractor, row, column);
            // Draws one of the measured values in the leaf. The seed depends only on the
            // ray, so that threads do not change the result.
            const double share = Random(hash_pair(seed, i)).sample_uniform();
            drawn[i] = scatter.values[leaf.first + std::size_t(share * double(leaf.count))];
        }
    };
    // In a wave, each row draws one tile, two tiles behind the row above, because a ray
    // also needs neighbours up to one tile ahead in that row. So a row draws tile
    // wave - 2 * row. The tiles of a wave do not depend on each other.
    const int n_tiles = (rendered.columns + kTileColumns - 1) / kTileColumns;
    const int n_waves = 2 * (rendered.rows - 1) + n_tiles;
    for (int wave = 0; wave < n_waves; ++wave) {
        // Only rows with 0 <= wave - 2 * row < n_tiles have such a tile.
        const int first_row = std::max(0, (wave - n_tiles + 2) / 2);
        const int last_row = std::min(rendered.rows - 1, wave / 2);
        parallel_for(last_row - first_row + 1, [&](int index) {
            const int row = first_row + index;
            draw_tile(row, wave - 2 * row);
        });
    }
    return drawn;
}

std::size_t count_features() { return scatter::kFeatures; }

}  // namespace relidar
