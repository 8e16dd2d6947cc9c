// SPDX-License-Identifier: Apache-2.0
// Decides which steps render a scan, and whether these steps run on the device or on the
// host. No other code makes this decision. Private to render.
#pragma once

#include <relidar/simulate/render.hpp>

namespace relidar {

struct ScanRenderSettings {
    std::vector<ChannelInfo> channels;
    ObservedVoxelSet coverage = {};
    std::vector<IntensityScatterModel> scatter = {};  ///< [lidars]
    Weather weather = {};
    bool has_views = false;  ///< if true, scans have RenderedScan::actor_views
};

struct ScanRenderPlan {
    SensorConfig beams;
    /// `device`: rays in device memory. `beams`: beams after the host has combined their
    /// sub-rays. `cells`: pixels of the sensor's range image grid.
    enum class RayDropStage { none, device, beams, cells } network = RayDropStage::none;
    /// True if the scan has no sub-rays, grid, channels, weather or random sampling.
    /// Otherwise place_points() computes equal points on the host.
    bool points_on_device = false;

    bool has_sub_rays() const { return beams.sub_rays > 1; }
};

/// @param rays one per beam, before they are split into sub-rays
/// @param network may be null
/// @throws UsageError if the sensor cannot be rendered with these settings
ScanRenderPlan plan_scan(const SimulatedSensor& sensor, const RayTable& rays, const Config& config,
                         const ScanRenderSettings& settings, const RayDropNetwork* network, bool sampled);

bool corrects_drop(const RayDropNetwork* network, const SimulatedSensor& sensor);

}  // namespace relidar
