// SPDX-License-Identifier: Apache-2.0
// The only place that decides which steps of a scan run, and whether they run on the
// device or on the host. Private to render.
#pragma once

#include <vector>

#include <relidar/simulate/render.hpp>

namespace relidar {

/// Settings of all scans of a renderer, in addition to those of its configuration.
struct ScanSettings {
    std::vector<ChannelInfo> channels;
    Coverage coverage = {};
    std::vector<IntensityScatter> scatter = {};  ///< [lidars]
    Weather weather = {};
};

/// Steps of a scan. Rays are always traced and measured on the device.
struct ScanPlan {
    /// Numbers of sub-rays and returns. The host joins the sub-rays of a beam.
    SensorConfig beams;
    /// Where the ray-drop network runs: on the rays of the device, on the joined beams,
    /// or on the cells of the grid.
    enum class Network { none, device, beams, cells } network = Network::none;
    /// True if the device computes the points: the scan needs neither sub-rays, grid,
    /// channels, weather nor sample. Otherwise place_points() computes equal points.
    bool points_on_device = false;

    bool splits_beams() const { return beams.sub_rays > 1; }
};

/// Plans the scan of a sensor.
/// @param rays rays of the sensor before they are split
/// @param network network that corrects the ray-drop; null: none
/// @throws UsageError if the sensor cannot be rendered with these settings
ScanPlan plan_scan(const SensorChoice& sensor, const RayTable& rays, const Config& config,
                   const ScanSettings& settings, const DropNetwork* network, bool is_sampled);

/// Returns true if a network corrects the ray-drop of a sensor's scans.
bool corrects_drops(const DropNetwork* network, const SensorChoice& sensor);

}  // namespace relidar
