// SPDX-License-Identifier: Apache-2.0
// Blocks of a background, read from their files when they are wanted.
#include <relidar/run.hpp>

#include <numeric>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar {
namespace {

Surfels read_block(const SceneBlock& block) {
    const Scene scene = load_model(block.file);
    const Model& background = scene.models.front();
    if (background.count != block.count)
        throw DataError(fmt::format("{}: found {} surfels of the background, expected {} as its run says", block.file.string(),
                                    background.count, block.count));
    return scene.surfels.slice(0, background.count);
}

}  // namespace

Scene read_blocks(const Scene& scene, const std::vector<std::size_t>& blocks) {
    const std::uint32_t in_memory = scene.models.front().count;
    Surfels background = scene.surfels.slice(0, in_memory);
    for (const std::size_t i : blocks) background.append(read_block(scene.blocks[i]));
    Scene read = layout_of(scene);
    read.blocks.clear();
    read.surfels = background.permuted(kd_order(background.mean));
    read.models.front().count = static_cast<std::uint32_t>(background.size());
    for (Model& model : read.models) model.first += &model == &read.models.front() ? 0 : read.models.front().count - in_memory;
    read.surfels.append(scene.surfels.slice(in_memory, scene.surfels.size() - in_memory));
    return read;
}

Scene whole_scene(const Scene& scene) {
    if (scene.blocks.empty()) return scene;
    std::vector<std::size_t> all(scene.blocks.size());
    std::iota(all.begin(), all.end(), std::size_t(0));
    return read_blocks(scene, all);
}

}  // namespace relidar
