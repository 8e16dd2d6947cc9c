// SPDX-License-Identifier: Apache-2.0
// The part of a scene that is on the device: all of it, or of one in blocks those that
// rays can reach.
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

/// Blocks that a scan needs are brought before it; others stay while they fit into
/// config.render.memory_mib, and those that were needed longest ago go first. A scene
/// without blocks is on the device from the start.
class ResidentScene {
public:
    ResidentScene(Device& device, const Scene& scene, const Config& config, const RendererOptions& options);

    /// Makes sure that all that lies within reach of a sensor is there. @param sensor_m
    /// [3] world @param reach_m  of its rays
    /// @throws DataError as read_blocks()
    void bring(const glm::vec3& sensor_m, double reach_m);
    /// After bring().
    Renderer& renderer() { return *renderer_; }
    /// All of a scene without blocks once more, to be rendered in the stream of
    /// renderer(), which outlives it. Blocks.
    /// @throws DeviceError where memory is exhausted
    std::unique_ptr<Renderer> copy();
    /// Of all renderings so far.
    const KernelTimes& times();

private:
    void load(const std::vector<std::size_t>& blocks);
    std::vector<std::size_t> with_kept(std::vector<std::size_t> needed) const;

    Device& device_;
    const ImageModel model_;
    const RendererOptions options_;
    const double memory_bytes_;
    const bool owns_models_;
    Scene scene_;  ///< blocks and what is in memory beside them; empty of surfels where there are no blocks
    std::optional<Renderer> renderer_;
    std::vector<std::size_t> loaded_;         ///< blocks on the device, ascending
    std::vector<std::uint64_t> last_needed_;  ///< [blocks] number of the scan; 0: never
    std::uint64_t scans_ = 0;
    double bytes_per_surfel_ = 0.0;  ///< of the last load
    KernelTimes past_, times_;       ///< of renderers that are gone; with those of the present one
};

}  // namespace relidar
