// SPDX-License-Identifier: Apache-2.0
// Requests scans and collects their points. The device renders a scan while the host
// processes an earlier scan.

#include <relidar/simulate/place_points.hpp>

#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

/// Copies points that the device has computed. Rounds their intensities to the steps of
/// the sensor.
/// @param points earlier points, whose memory is reused
LidarPoints copy_points(std::span<const shared::ReturnedPoint> returned,
                        const IntensityScatterModel& intensity_steps, LidarPoints points) {
    constexpr std::size_t kPointsPerTask = 1 << 13;
    static_assert(std::int32_t(RELIDAR_NO_INSTANCE) == -1);  // host value for "no instance"
    const std::size_t n = returned.size();
    points.position_m.resize(n);
    points.intensity.resize(n);
    points.ring.resize(n);
    points.time_offset_s.resize(n);
    points.instance.resize(n);
    // Points from the device have none of these optional values.
    points.return_number.clear();
    points.firing.clear();
    points.channels.clear();
    parallel_ranges(n, kPointsPerTask, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const shared::ReturnedPoint& point = returned[i];
            points.position_m[i] = point.position;
            points.intensity[i] = intensity_steps.quantise(point.intensity);
            points.ring[i] = std::uint16_t(point.ring);
            points.time_offset_s[i] = point.time_offset_s;
            points.instance[i] = std::int32_t(point.instance);
        }
    });
    return points;
}

/// Returns the share of a scan's rays in space that the log has not observed.
/// @param sampled_m [samples] ranges of evenly spaced rays, see sample_ray(); 0: no hit
double unseen_share_of(const SubmittedScan& scan, std::span<const float> sampled_m) {
    const RayTable& rays = scan.rays->ray_table();
    const auto sampled_ray = [&](std::size_t sample) {
        const std::size_t i = DevicePointComputer::sample_ray(sample, rays.size());
        const double time_s = scan.time_s + double(rays.time_offset_s[i]);
        return RayWithSurfaceRange{.dataset_from_firing = scan.dataset_from_sensor.pose_at(time_s),
                                   .origin_m = glm::dvec3(rays.origin[i]),
                                   .direction = glm::dvec3(rays.direction[i]),
                                   .met_m = sampled_m[sample]};
    };
    return unobserved_share(sampled_m.size(), sampled_ray, *scan.observed_space);
}

bool is_for_device(const PendingPoints& points) {
    const auto* scan = std::get_if<SubmittedScan>(&points);
    return scan ? scan->device_points.has_value() : std::holds_alternative<DevicePoints>(points);
}

}  // namespace

/// Submits GPU commands that render a sweep and compute its points, without waiting.
/// @param timing `with_next` delays the commands until those of the next scan are
/// submitted, so that both scans run in parallel
/// @param memory PointMemory::device keeps the points on the device
/// @param with_network true to run the ray-drop network as well
SubmittedScan ScanRenderer::Impl::submit_sweep(const SimulatedSweep& sweep, const Pose& dataset_from_points,
                                               SubmissionTiming timing, PointMemory memory,
                                               bool with_network) {
    const WaitOnError wait_on_error{*this};  // for the device
    const SimulatedSensor& sensor = sweep.sensor;
    const RayTable& rays = sweep.rays();
    RenderLane& lane = lanes->choose_lane(timing);
    prepare_scene(lane, sweep);
    Renderer& renderer = lane.renderer();
    SubmittedScan scan{
        .rays = record_trace(lane, sweep, rays, with_network),
        .renderer = renderer,
        .dataset_from_sensor = shift_track(sweep.world_from_sensor, sweeps.log().world_offset_m),
        .dataset_from_points = dataset_from_points,
        .time_s = sweep.time_s,
        .intensity_steps = {.step = settings.scatter[std::size_t(sensor.lidar)].step},
        .observed_space =
            sweeps.is_background_shown() ? std::optional(observed_space_of(sensor)) : std::nullopt};
    if (memory == PointMemory::device)
        scan.device_points = {.points = {device, rays.size(), "points of a scan"},
                              .n_rays = rays.size(),
                              .dataset_from_points = dataset_from_points,
                              .time_s = sweep.time_s};
    scan.results =
        lane.points.record(renderer.stream(), *scan.rays,
                           {.points_from_sensor = to_frame(scan.dataset_from_sensor, dataset_from_points),
                            .time_s = sweep.time_s,
                            .is_at_median_range = config.render.points == "median",
                            .target = scan.device_points ? &scan.device_points->points : nullptr},
                           renderer.forward_pass().n_truncated_rays());
    lanes->submit(timing);
    return scan;
}

/// Copies points that the host has computed to the device.
DevicePoints ScanRenderer::Impl::upload_points(const RenderedPoints& rendered) {
    const LidarPoints& from = rendered.points;
    std::vector<shared::ReturnedPoint> points;
    for (std::size_t i = 0; i < from.position_m.size(); ++i)
        points.push_back({.position = from.position_m[i],
                          .intensity = from.intensity[i],
                          .time_offset_s = from.time_offset_s[i],
                          .ring = from.ring[i],
                          .instance = std::uint32_t(from.instance[i])});
    return {.points = {device, points, "points of a scan"},
            .n_points = points.size(),
            .n_rays = rendered.n_rays,
            .dataset_from_points = from.world_from_points,
            .time_s = from.time_s};
}

/// Waits for the points of a submitted scan, and replaces the scan by them. Does nothing
/// if the request already has its points.
/// @param reused earlier points, whose memory is reused
void ScanRenderer::Impl::finish_scan(PendingPoints& request, LidarPoints reused) {
    auto* scan = std::get_if<SubmittedScan>(&request);
    if (!scan) return;
    lanes->submit_batch();  // the commands of the scan may only be recorded
    const DevicePointComputer::GatheredPoints gathered =
        DevicePointComputer::wait(scan->renderer.stream(), *scan->results);
    if (gathered.n_truncated > 0) scan->renderer.check_truncation();
    if (scan->device_points) {  // the device has written them to this array
        DevicePoints points = std::move(*scan->device_points);
        points.n_points = gathered.n_points;
        request = std::move(points);
        return;
    }
    RenderedPoints result{copy_points(gathered.points, scan->intensity_steps, std::move(reused)),
                          scan->rays->ray_table().size()};
    result.points.world_from_points = scan->dataset_from_points;
    result.points.time_s = scan->time_s;
    if (scan->observed_space && !scan->observed_space->coverage.empty())
        result.unseen_share = unseen_share_of(*scan, gathered.sampled_m);
    request = std::move(result);
}

void ScanRenderer::Impl::finish_pending() {
    for (PendingPoints& request : pending) finish_scan(request);
}

void ScanRenderer::submit_points(const SimulatedSensor& sensor, const ScanRequest& request,
                                 double points_time_s, SampleSeed seed, SubmissionTiming timing,
                                 PointMemory memory) {
    Impl& renderer = *impl_;
    if (renderer.pending.size() >= kScansInFlight)
        fail<UsageError>(
            "{} requested scans have not been read yet, expected fewer than {}: call wait_for_points()",
            renderer.pending.size(), kScansInFlight);
    const SimulatedSweep sweep = renderer.sweeps.of_request(sensor, request);
    const Pose dataset_from_points = request.dataset_from_sensor.pose_at(points_time_s);
    const ScanRenderPlan plan = renderer.plan_sweep(sweep, seed.has_value());
    if (plan.points_on_device) {
        const bool with_network = plan.network == ScanRenderPlan::RayDropStage::device;
        renderer.pending.push_back(
            renderer.submit_sweep(sweep, dataset_from_points, timing, memory, with_network));
        return;
    }
    // The host computes all other points now, so `timing` has no effect.
    const RenderedScan scan = renderer.render_sweep(sweep, seed);
    RenderedPoints points{place_points(scan, renderer.config, dataset_from_points), scan.image.range_m.size(),
                          scan.unseen_share};
    if (memory == PointMemory::device) renderer.pending.push_back(renderer.upload_points(points));
    else renderer.pending.push_back(std::move(points));
}

/// Removes the oldest requested scan from the queue and waits for its points.
/// @param reused earlier points, whose memory is reused
PendingPoints ScanRenderer::Impl::take_pending(PointMemory memory, LidarPoints reused) {
    if (pending.empty())
        throw UsageError(
            "cannot read the points of a scan: no scan was requested; call submit_points() first");
    if (is_for_device(pending.front()) != (memory == PointMemory::device))
        throw UsageError(
            "cannot read the points of a scan: they are in the other memory; call wait_for_points() for "
            "PointMemory::host and wait_for_device_points() for PointMemory::device");
    PendingPoints oldest = std::move(pending.front());
    pending.pop_front();
    finish_scan(oldest, std::move(reused));
    return oldest;
}

RenderedPoints ScanRenderer::wait_for_points(LidarPoints memory) {
    return std::get<RenderedPoints>(impl_->take_pending(PointMemory::host, std::move(memory)));
}

DevicePoints ScanRenderer::wait_for_device_points() {
    return std::get<DevicePoints>(impl_->take_pending(PointMemory::device));
}

/// Waits until the device no longer uses the arrays of this object. First submits
/// commands that are only recorded.
void ScanRenderer::Impl::wait_for_device() noexcept {
    try {
        lanes->submit_batch();
        if (scene.is_loaded()) scene.renderer().stream().submit_and_wait();
    } catch (const Error&) {  // nothing to do, because a lost device no longer writes to memory
    }
}

ScanRenderer::~ScanRenderer() { impl_->wait_for_device(); }

}  // namespace relidar
