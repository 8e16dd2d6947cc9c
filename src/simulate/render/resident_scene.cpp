// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/resident_scene.hpp"

#include <relidar/run/run.hpp>

namespace relidar {
namespace {

constexpr double kMaxSweepMotion_m = 10.0;  // maximum distance in metres that a sensor moves during a sweep
constexpr double kMiB = 1024.0 * 1024.0;

}  // namespace

ResidentScene::ResidentScene(Device& device, const Scene& scene, const Config& config,
                             const RendererOptions& options)
    : device_(device),
      model_(config.image),
      options_(options),
      memory_bytes_(config.render.memory_mib * kMiB),
      has_model_copy_(config.image.sh_direction == ShDirection::surfel || scene.surfels.bends),
      scene_(scene.blocks.empty() ? Scene{} : scene),
      last_needed_(scene.blocks.size(), 0) {
    if (scene.blocks.empty())
        renderer_.emplace(device, has_model_copy_ ? unshare_models(scene) : scene, model_, options_);
}

/// Replaces the renderer by a renderer of these blocks. Measures the memory per surfel,
/// which predicts how many blocks fit.
void ResidentScene::load_blocks(const std::vector<std::size_t>& blocks) {
    if (renderer_) past_.add_times(renderer_->stream().times());
    // frees memory before the new renderer allocates
    renderer_.reset();
    loaded_.clear();
    Scene scene = with_blocks(scene_, blocks);
    if (has_model_copy_) scene = unshare_models(std::move(scene));
    const std::uint64_t before = device_.allocated_bytes();
    renderer_.emplace(device_, scene, model_, options_);
    bytes_per_surfel_ =
        double(device_.allocated_bytes() - before) / double(std::max<std::size_t>(scene.surfels.size(), 1));
    loaded_ = blocks;
}

/// Adds other loaded blocks to the blocks that a scan needs, while they fit into memory.
/// Prefers the most recently needed blocks, because the sensor may return to them.
std::vector<std::size_t> ResidentScene::add_recent_blocks(std::vector<std::size_t> blocks) const {
    double bytes = 0.0;
    for (const std::size_t i : blocks) bytes += scene_.blocks[i].count * bytes_per_surfel_;
    std::vector<std::size_t> others;
    std::set_difference(loaded_.begin(), loaded_.end(), blocks.begin(), blocks.end(),
                        std::back_inserter(others));
    std::sort(others.begin(), others.end(), [this](std::size_t first, std::size_t second) {
        return last_needed_[first] > last_needed_[second];
    });
    for (const std::size_t i : others) {
        bytes += scene_.blocks[i].count * bytes_per_surfel_;
        if (bytes > memory_bytes_) break;
        blocks.push_back(i);
    }
    std::sort(blocks.begin(), blocks.end());
    return blocks;
}

void ResidentScene::load_near(const glm::vec3& sensor_position_m, double max_range_m) {
    ++scans_;
    std::vector<std::size_t> needed;
    for (std::size_t i = 0; i < scene_.blocks.size(); ++i) {
        if (scene_.blocks[i].count == 0 ||
            scene_.blocks[i].distance_m(sensor_position_m) > max_range_m + kMaxSweepMotion_m)
            continue;
        needed.push_back(i);
        last_needed_[i] = scans_;
    }
    if (!renderer_ || !std::includes(loaded_.begin(), loaded_.end(), needed.begin(), needed.end()))
        load_blocks(add_recent_blocks(std::move(needed)));
}

std::unique_ptr<Renderer> ResidentScene::copy_renderer() {
    RendererOptions options = options_;
    options.stream = &renderer_->stream();
    return std::make_unique<Renderer>(device_, renderer_->download_scene(), model_, options);
}

const KernelTimes& ResidentScene::kernel_times() {
    if (renderer_ && past_.milliseconds.empty()) return renderer_->stream().times();
    times_ = past_;
    if (renderer_) times_.add_times(renderer_->stream().times());
    return times_;
}

}  // namespace relidar
