// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/scan_renderer.hpp"

#include "base/fail.hpp"

namespace relidar {
namespace {

/// RayDropNetwork::image if the image has one pixel per ray; other values name a grid.
constexpr const char* kNativeGrid = "native";

/// Checks that the beams of a sensor can be split into sub-rays.
/// @throws UsageError for a beam without divergence, or for conflicting settings
void check_sub_rays(const RayTable& rays, const SensorConfig& config, const SimulatedSensor& sensor) {
    if (sensor.grid && config.returns > 1)
        fail<UsageError>(
            "sensor.returns: found 2 for {}, expected 1, because its range image has one range per pixel",
            sensor.name);
    if (config.sub_rays == 1 && config.returns > 1)
        throw UsageError(
            "sensor.returns: found 2 with sensor.sub_rays=1, expected sensor.sub_rays=5 or 9, because a "
            "single ray has only one return");
    if (config.sub_rays == 1) return;
    if (config.sub_rays != 5 && config.sub_rays != 9)
        fail<UsageError>("sensor.sub_rays: found {}, expected 1, 5 or 9", config.sub_rays);
    if (!(config.divergence_mrad > 0.0 || rays.max_divergence_rad() > 0.0))
        fail<UsageError>("sensor.sub_rays: the beam divergence of {} is unknown; set sensor.divergence_mrad",
                         sensor.name);
    if (rays.size() * std::size_t(config.sub_rays) > kMaxRays)
        fail<UsageError>("sensor.sub_rays: found {} for {} rays, expected at most {} rays in total",
                         config.sub_rays, rays.size(), kMaxRays);
}

/// Returns true if the network can correct an image with this name and size.
bool fits_network(const RayDropNetwork* network, const std::string& image_name, int rows, int columns) {
    if (!network || network->image != image_name) return false;
    // A network with 1 x 1 convolutions processes each ray separately, so an image of one
    // pixel is enough.
    const int side = network->taps == 1 ? 1 : std::max(2, network->min_image_size());
    return rows >= side && columns >= side;
}

/// Decides where the ray-drop network runs: on the device directly after tracing, on
/// beams that are joined from sub-rays, on the cells of a grid, or nowhere.
ScanRenderPlan::RayDropStage choose_drop_stage(const RayDropNetwork* network, const SimulatedSensor& sensor,
                                               const RayTable& rays, bool has_sub_rays) {
    using enum ScanRenderPlan::RayDropStage;
    if (sensor.camera) return none;
    if (fits_network(network, kNativeGrid, rays.rows, rays.columns) ||
        (!sensor.grid && fits_network(network, sensor.name, rays.rows, rays.columns)))
        return has_sub_rays ? beams : device;
    const RangeImageGrid* grid = sensor.grid ? &*sensor.grid : nullptr;
    return grid && fits_network(network, grid->name, grid->rows, grid->columns) ? cells : none;
}

}  // namespace

ScanRenderPlan plan_scan(const SimulatedSensor& sensor, const RayTable& rays, const Config& config,
                         const ScanRenderSettings& settings, const RayDropNetwork* network, bool sampled) {
    ScanRenderPlan plan{.beams = config.sensor};
    if (sensor.returns > 0) plan.beams.returns = sensor.returns;
    if (sensor.camera) {
        plan.beams.sub_rays = 1;
        if (sampled || !settings.weather.is_clear())
            fail<UsageError>(
                "cannot render the camera {}: found {}, expected none, because it is that of a LiDAR",
                sensor.name, sampled ? "a random seed" : "weather");
    }
    // A beam needs several sub-rays to have returns from two surfaces.
    constexpr int kSubRaysOfTwoReturns = 9;
    if (sensor.returns > 1 && plan.beams.sub_rays == 1) plan.beams.sub_rays = kSubRaysOfTwoReturns;
    check_sub_rays(rays, plan.beams, sensor);
    if (rays.size() == 0)
        fail<UsageError>(
            "cannot render {}: this sensor does not spin and defines no rays; use another sensor",
            sensor.name);
    plan.network = choose_drop_stage(network, sensor, rays, plan.has_sub_rays());
    // The device computes only the points of plain scans with the same rays in each scan.
    // Other steps need the host.
    plan.points_on_device = !sampled && settings.weather.is_clear() && settings.channels.empty() &&
                            !sensor.grid && !plan.has_sub_rays() && sensor.rays.size() > 0 &&
                            sensor.body.empty();
    return plan;
}

bool corrects_drop(const RayDropNetwork* network, const SimulatedSensor& sensor) {
    return choose_drop_stage(network, sensor, sensor.rays, false) != ScanRenderPlan::RayDropStage::none;
}

}  // namespace relidar
