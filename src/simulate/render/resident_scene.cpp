// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/resident_scene.hpp"

#include <relidar/gpu/out_of_memory.hpp>
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
      scene_(scene.blocks.empty() ? Scene{} : scene),
      last_needed_(scene.blocks.size(), 0) {
    // A scene with blocks is loaded by load_near().
    if (scene.blocks.empty()) renderer_.emplace(device, scene, model_, options_);
}

/// Replaces the renderer by a renderer of another scene.
/// @return bytes of device memory that the new renderer needs
std::uint64_t ResidentScene::load_scene(const Scene& scene) {
    if (renderer_) past_.add_times(renderer_->stream().times());
    renderer_.reset();  // frees memory before the new renderer allocates
    const std::uint64_t before = device_.allocated_bytes();
    renderer_.emplace(device_, scene, model_, options_);
    return device_.allocated_bytes() - before;
}

/// Replaces the renderer by a renderer of these blocks. Measures the memory per surfel,
/// which predicts how many blocks fit.
void ResidentScene::load_blocks(const std::vector<std::size_t>& blocks) {
    loaded_.clear();  // nothing is loaded if an allocation fails
    const Scene scene = with_blocks(scene_, blocks);
    const std::uint64_t n_bytes = load_scene(scene);
    bytes_per_surfel_ = double(n_bytes) / double(std::max<std::size_t>(scene.surfels.size(), 1));
    loaded_ = blocks;
}

/// Adds other loaded blocks to the blocks that a scan needs, while they fit into memory.
/// Prefers the most recently needed blocks, because the sensor may return to them.
std::vector<std::size_t> ResidentScene::add_recent_blocks(std::vector<std::size_t> blocks) const {
    double n_bytes = 0.0;
    for (const std::size_t i : blocks) n_bytes += scene_.blocks[i].count * bytes_per_surfel_;
    // Loaded blocks that this scan does not need, the most recently needed first.
    std::vector<std::size_t> others;
    std::set_difference(loaded_.begin(), loaded_.end(), blocks.begin(), blocks.end(),
                        std::back_inserter(others));
    std::sort(others.begin(), others.end(), [this](std::size_t first, std::size_t second) {
        return last_needed_[first] > last_needed_[second];
    });
    for (const std::size_t i : others) {
        n_bytes += scene_.blocks[i].count * bytes_per_surfel_;
        if (n_bytes > memory_bytes_) break;
        blocks.push_back(i);
    }
    std::sort(blocks.begin(), blocks.end());
    return blocks;
}

void ResidentScene::load_near(const glm::vec3& sensor_position_m, double max_range_m) {
    ++n_scans_;
    const double reach_m = max_range_m + kMaxSweepMotion_m;
    std::vector<std::size_t> needed;
    for (std::size_t i = 0; i < scene_.blocks.size(); ++i) {
        const SceneBlock& block = scene_.blocks[i];
        if (block.count == 0 || block.distance_m(sensor_position_m) > reach_m) continue;
        needed.push_back(i);
        last_needed_[i] = n_scans_;
    }
    // Loads only if a needed block is missing. Both lists are ascending.
    if (!renderer_ || !std::includes(loaded_.begin(), loaded_.end(), needed.begin(), needed.end()))
        load_blocks(add_recent_blocks(std::move(needed)));
}

std::unique_ptr<Renderer> ResidentScene::copy_renderer() {
    RendererOptions options = options_;
    options.stream = &renderer_->stream();
    return std::make_unique<Renderer>(device_, renderer_->download_scene(), model_, options);
}

bool ResidentScene::must_reload(const Scene& added) const {
    return renderer_ && added.surfels.bends && !renderer_->scene().surfel_parameters().bends;
}

/// Loads the scene again with one more model.
/// @return index of the model
std::uint32_t ResidentScene::reload_with(const Scene& added) {
    const Scene before = renderer_->download_scene();
    Scene scene = before;
    const std::uint32_t model = append_model(scene, added, 0);
    try {
        load_scene(scene);
    } catch (const OutOfDeviceMemory&) {
        load_scene(before);  // so that the renderer stays usable
        throw;
    }
    return model;
}

std::uint32_t ResidentScene::add_model(const Scene& added) {
    std::uint32_t model = 0;
    if (renderer_) model = must_reload(added) ? reload_with(added) : renderer_->append_model(added);
    // Later loads of blocks need the model as well, with the same index.
    if (has_blocks()) model = append_model(scene_, added, 0);
    return model;
}

void ResidentScene::add_instance(const ModelInstance& instance) {
    if (renderer_) renderer_->append_instance(instance);
    if (has_blocks()) scene_.instances.push_back(instance);
}

Scene ResidentScene::copy_model(std::uint32_t model) {
    Scene copy;
    copy.instances = {{.model = 0, .track = "copy"}};  // a placeholder, because actors need a track
    if (!renderer_) {
        // No blocks were loaded yet, so the model is only in host memory.
        append_model(copy, scene_, model);
        return copy;
    }
    const DeviceScene& scene = renderer_->scene();
    copy.models = {scene.layout().models[model]};
    SurfelModel& copied = copy.models.front();  // has the range of the surfels on the device
    copy.surfels = scene.surfel_parameters().download_range(copied.first, copied.count);
    copied.first = 0;  // `copy` has only these surfels
    return copy;
}

const KernelTimes& ResidentScene::kernel_times() {
    if (renderer_ && past_.milliseconds.empty()) return renderer_->stream().times();
    times_ = past_;
    if (renderer_) times_.add_times(renderer_->stream().times());
    return times_;
}

}  // namespace relidar
