// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/scan_plan.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

/// A ray-drop network with this image name corrects the rays of the sensor. With other
/// names, it corrects the cells of a grid.
constexpr const char* kNative = "native";

SensorConfig list_beams(const SensorChoice& sensor, const Config& config) {
    SensorConfig beams = config.sensor;
    if (sensor.returns > 0) beams.returns = sensor.returns;
    if (sensor.returns > 1 && beams.sub_rays == 1) beams.sub_rays = 9;
    return beams;
}

/// Checks that the beams of a sensor can be split into sub-rays.
/// @throws UsageError for a beam without divergence
void check_beams(const RayTable& rays, const SensorConfig& beams, const SensorChoice& sensor) {
    if (sensor.grid && beams.returns > 1)
        throw UsageError(fmt::format(
            "sensor.returns: found 2 for {}, expected 1, because its image has one range per pixel",
            sensor.name));
    if (beams.sub_rays == 1 && beams.returns > 1)
        throw UsageError(
            "sensor.returns=2 needs sensor.sub_rays of 5 or 9, because a single ray has only one "
            "return");
    if (beams.sub_rays == 1) return;
    if (beams.sub_rays != 5 && beams.sub_rays != 9)
        throw UsageError(fmt::format("sensor.sub_rays: found {}, expected 1, 5 or 9", beams.sub_rays));
    if (!(beams.divergence_mrad > 0.0 || rays.find_largest_divergence() > 0.0))
        throw UsageError(
            fmt::format("sensor.sub_rays: the beam divergence of {} is unknown; set sensor.divergence_mrad",
                        sensor.name));
    if (rays.size() * std::size_t(beams.sub_rays) > kMaxRays)
        throw UsageError(
            fmt::format("sensor.sub_rays: found {} for {} rays, expected at most {} rays in total",
                        beams.sub_rays, rays.size(), kMaxRays));
}

/// Returns true if the network exists and can correct an image with this name and this
/// number of rows and columns.
bool has_drop_correction(const DropNetwork* network, const std::string& image, int rows, int columns) {
    if (!network || network->image != image) return false;
    // A network with 1 x 1 convolutions processes each ray separately, so it needs no
    // image.
    const int side = network->taps == 1 ? 1 : std::max(2, network->smallest_side());
    return rows >= side && columns >= side;
}

ScanPlan::Network choose_network_stage(const DropNetwork* network, const SensorChoice& sensor,
                                       const RayTable& rays, bool splits_beams) {
    using enum ScanPlan::Network;
    if (has_drop_correction(network, kNative, rays.rows, rays.columns) ||
        (!sensor.grid && has_drop_correction(network, sensor.name, rays.rows, rays.columns)))
        return splits_beams ? beams : device;
    const RangeGrid* grid = sensor.grid ? &*sensor.grid : nullptr;
    return grid && has_drop_correction(network, grid->name, grid->rows, grid->columns) ? cells : none;
}

}  // namespace

ScanPlan plan_scan(const SensorChoice& sensor, const RayTable& rays, const Config& config,
                   const ScanSettings& settings, const DropNetwork* network, bool is_sampled) {
    ScanPlan plan{.beams = list_beams(sensor, config)};
    check_beams(rays, plan.beams, sensor);
    if (rays.size() == 0)
        throw UsageError(
            fmt::format("cannot render {}: this sensor does not spin and defines no rays; use another sensor",
                        sensor.name));
    plan.network = choose_network_stage(network, sensor, rays, plan.splits_beams());
    plan.points_on_device = !is_sampled && settings.weather.clear() && settings.channels.empty() &&
                            !sensor.grid && !plan.splits_beams() && sensor.rays.size() > 0;
    return plan;
}

bool is_drop_correction_used(const DropNetwork* network, const SensorChoice& sensor) {
    return choose_network_stage(network, sensor, sensor.rays, false) != ScanPlan::Network::none;
}

}  // namespace relidar
