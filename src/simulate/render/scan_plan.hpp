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

/// Says how a scan is rendered: sub-rays per beam, input of the ray-drop network, and
/// where points are computed.
struct ScanRenderPlan {
    /// number of rays that are traced for each beam (sub-rays), and number of returns per
    /// beam
    SensorConfig beams;
    /// Input of the ray-drop network. `device`: rays in device memory. `beams`: beams,
    /// after the host has combined their sub-rays. `cells`: pixels of the sensor's range
    /// image grid. `none`: no network is used.
    enum class RayDropStage { none, device, beams, cells } network = RayDropStage::none;
    /// True if the device computes the points. The scan must not have sub-rays, grid,
    /// channels, weather or random sampling. Otherwise place_points() computes the same
    /// points on the host.
    bool points_on_device = false;

    bool has_sub_rays() const { return beams.sub_rays > 1; }
};

/// Decides how the scans of a sensor are rendered.
/// @param rays rays of the sensor, one per beam, before they are split into sub-rays
/// @param network network that corrects the ray-drop probabilities, or null
/// @throws UsageError if the sensor cannot be rendered with these settings
ScanRenderPlan plan_scan(const SimulatedSensor& sensor, const RayTable& rays, const Config& config,
                         const ScanRenderSettings& settings, const RayDropNetwork* network,
                         bool has_random_sampling);

/// Returns true if a network corrects the ray-drop of this sensor.
bool is_drop_correction_used(const RayDropNetwork* network, const SimulatedSensor& sensor);

}  // namespace relidar
