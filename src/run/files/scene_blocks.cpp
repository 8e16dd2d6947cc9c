// SPDX-License-Identifier: Apache-2.0
// Loads blocks (parts of the background of a large scene) from their files.
#include <relidar/run/run.hpp>

#include <numeric>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {

Surfels load_block_surfels(const SceneBlock& block) {
    const Scene scene = load_model(block.file);
    const SurfelModel& background = scene.models.front();
    if (background.count != block.count)
        throw DataError(
            fmt::format("{}: the block has {} surfels of the background, expected {} as stored in the run",
                        block.file.string(), background.count, block.count));
    return scene.surfels.slice(0, background.count);
}

Scene load_selected_blocks(const Scene& scene, const std::vector<std::size_t>& block_indices) {
    Surfels background = scene.surfels.slice(0, scene.models.front().count);
    for (const std::size_t i : block_indices) background.append(load_block_surfels(scene.blocks[i]));
    return replace_background(scene, background);
}

Scene load_all_blocks(const Scene& scene) {
    if (scene.blocks.empty()) return scene;
    std::vector<std::size_t> all(scene.blocks.size());
    std::iota(all.begin(), all.end(), std::size_t(0));
    return load_selected_blocks(scene, all);
}

}  // namespace relidar
