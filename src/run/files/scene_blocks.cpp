// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/run.hpp>

#include <numeric>

#include "base/fail.hpp"

namespace relidar {

Surfels load_block(const SceneBlock& block) {
    const Scene scene = load_model(block.file);
    // The background is the first model, so its surfels precede all others.
    const SurfelModel& background = scene.models.front();
    if (background.count != block.count)
        fail(
            "{}: this file of a block has {} background surfels, but model.safetensors of the run lists {} "
            "for the block; expected the file that was saved with the run",
            block.file.string(), background.count, block.count);
    return scene.surfels.slice(0, background.count);
}

Scene with_blocks(const Scene& scene, const std::vector<std::size_t>& block_indices) {
    Surfels background = scene.surfels.slice(0, scene.models.front().count);
    for (const std::size_t i : block_indices) background.append_surfels(load_block(scene.blocks[i]));
    return replace_background(scene, background);
}

Scene with_all_blocks(const Scene& scene) {
    if (scene.blocks.empty()) return scene;
    std::vector<std::size_t> all(scene.blocks.size());
    std::iota(all.begin(), all.end(), std::size_t(0));
    return with_blocks(scene, all);
}

}  // namespace relidar
