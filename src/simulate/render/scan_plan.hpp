// SPDX-License-Identifier: Apache-2.0
// Decides which steps render a scan, and whether these steps run on the device or on the
// host. No other code makes this decision. Private to render.
#pragma once

#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Settings that apply to all scans of a renderer, in addition to the configuration.
struct ScanRenderSettings {
    std::vector<ChannelInfo> channels;
    ObservedVoxelSet coverage = {};
    std::vector<IntensityScatterModel> scatter = {};  ///< [lidars]
    Weather weather = {};
    bool has_views = false;  ///< if true, scans have RenderedScan::actor_views
};

/// The steps that render a scan. The device always traces the rays.
struct ScanRenderPlan {
    /// number of sub-rays and number of returns of each beam; the host joins the sub-rays
    SensorConfig beams;
    /// Rays that the ray-drop network corrects: traced rays on the device, joined beams,
    /// or cells of a grid.
    enum class RayDropStage { none, device, beams, cells } network = RayDropStage::none;
    /// True if the device computes the points. The scan must not have sub-rays, grid,
    /// channels, weather or random sampling. Otherwise place_points() computes the same
    /// points on the host.
    bool points_on_device = false;

    bool has_sub_rays() const { return beams.sub_rays > 1; }
};

/// Selects the steps for the scans of a sensor.
/// @param rays rays of the sensor before they are split into sub-rays
/// @param network network that corrects the ray-drop, or null
/// @throws UsageError if the sensor cannot be rendered with these settings
ScanRenderPlan plan_scan(const SimulatedSensor& sensor, const RayTable& rays, const Config& config,
                         const ScanRenderSettings& settings, const RayDropNetwork* network,
                         bool has_random_sampling);

/// Returns true if a network corrects the ray-drop of this sensor.
bool is_drop_correction_used(const RayDropNetwork* network, const SimulatedSensor& sensor);

}  // namespace relidar
