// SPDX-License-Identifier: Apache-2.0
// Keeps the scene on the device, or only those of its blocks that rays can reach.
#pragma once

#include <glm/glm.hpp>

#include <relidar/diff/forward.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

/// A scene on the device. Of a scene in blocks, loads the blocks near the sensor. Others
/// stay while they fit into config.render.memory_mib; the least recently needed go first.
class ResidentScene {
public:
    ResidentScene(Device& device, const Scene& scene, const Config& config, const RendererOptions& options);

    /// Loads all blocks of the scene within the range of a sensor.
    /// @throws DataError if the file of a block is invalid
    void load_near(const glm::vec3& sensor_position_m, double max_range_m);
    /// Call load_near() before.
    Renderer& renderer() { return *renderer_; }
    bool is_loaded() const { return renderer_.has_value(); }
    bool has_blocks() const { return !scene_.blocks.empty(); }
    /// Copies the scene on the device, so that several scans can be rendered in parallel.
    /// The scene must not have blocks. renderer() must outlive the copy, because both use
    /// the same stream.
    /// @throws DeviceError if memory is exhausted
    std::unique_ptr<Renderer> copy_renderer();
    /// Returns true if add_model() loads the scene again, because the model is a walking
    /// actor and the scene has none.
    bool must_reload(const Scene& added) const;
    /// Adds the only model of another scene.
    /// @return index of the model
    std::uint32_t add_model(const Scene& added);
    void add_instance(const ModelInstance& instance);
    /// Returns a scene that contains only a copy of this model.
    Scene copy_model(std::uint32_t model);
    const KernelTimes& kernel_times();

private:
    std::uint64_t load_scene(const Scene& scene);
    std::uint32_t reload_with(const Scene& added);
    void load_blocks(const std::vector<std::size_t>& blocks);
    std::vector<std::size_t> add_recent_blocks(std::vector<std::size_t> blocks) const;

    Device& device_;
    const ImageModel model_;
    const RendererOptions options_;
    const double memory_bytes_;
    Scene scene_;  ///< blocks and parts that always stay in memory; empty without blocks
    std::optional<Renderer> renderer_;
    std::vector<std::size_t> loaded_;  ///< blocks on the device, in ascending order
    /// [blocks] last scan that needed the block; 0 if none
    std::vector<std::uint64_t> last_needed_;
    std::uint64_t n_scans_ = 0;
    double bytes_per_surfel_ = 0.0;  ///< measured when blocks were loaded last
    KernelTimes past_, times_;
};

}  // namespace relidar
