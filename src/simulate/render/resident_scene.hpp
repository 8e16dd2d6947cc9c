// SPDX-License-Identifier: Apache-2.0
// Keeps the scene on the device. If the scene is divided into blocks, loads only the
// blocks that rays can reach.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/diff/forward.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// A scene on the device. A large scene is divided into blocks. Only blocks near the
/// sensor must be loaded. Other loaded blocks stay while they fit into
/// config.render.memory_mib. The least recently needed blocks are removed first. The
/// constructor loads a scene without blocks.
class ResidentScene {
public:
    ResidentScene(Device& device, const Scene& scene, const Config& config, const RendererOptions& options);

    /// Loads all blocks of the scene within the range of a sensor.
    /// @param sensor_position_m [3] position of the sensor, world frame
    /// @param max_range_m maximum range of its rays
    /// @throws DataError if the file of a block is invalid
    void load_blocks_near_sensor(const glm::vec3& sensor_position_m, double max_range_m);
    /// Returns the renderer of the loaded scene. Call load_blocks_near_sensor() before.
    Renderer& renderer() { return *renderer_; }
    bool has_loaded_renderer() const { return renderer_.has_value(); }
    /// Copies the scene on the device, so that several scans can be rendered in parallel.
    /// The scene must not be divided into blocks. renderer() must outlive the copy,
    /// because both use the same stream. Waits until the copy is finished.
    /// @throws DeviceError if memory is exhausted
    std::unique_ptr<Renderer> copy_scene_to_new_renderer();
    /// Returns the kernel times of all renderings so far.
    const KernelTimes& get_kernel_times();

private:
    void load_blocks(const std::vector<std::size_t>& block_indices);
    std::vector<std::size_t> add_recently_needed_blocks(std::vector<std::size_t> block_indices) const;

    Device& device_;
    const ImageFormationModel model_;
    const RendererOptions options_;
    const double memory_bytes_;
    const bool has_model_copy_;
    Scene scene_;  ///< blocks and parts that always stay in memory; empty without blocks
    std::optional<Renderer> renderer_;
    std::vector<std::size_t> loaded_;  ///< blocks on the device, in ascending order
    /// [blocks] number of the last scan that needed the block; 0 if no scan has needed it
    std::vector<std::uint64_t> last_needed_;
    std::uint64_t scans_ = 0;
    double bytes_per_surfel_ = 0.0;  ///< measured when blocks were loaded last
    /// `past_` has the kernel times of replaced renderers. `times_` has these times plus
    /// the times of the current renderer.
    KernelTimes past_, times_;
};

}  // namespace relidar
