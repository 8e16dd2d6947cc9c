// SPDX-License-Identifier: Apache-2.0
// Requests scans and collects their points. The device renders a scan while the host
// processes an earlier scan.
#include <algorithm>
#include <cstdint>
#include <span>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/accel.hpp>
#include <relidar/simulate/place_points.hpp>

#include "base/parallel.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

/// Copies points that the device computed to the arrays of `Points`. Rounds the
/// intensities to the steps of the sensor.
void copy_points(std::span<const shared::ReturnedPoint> returned_points, const IntensityScatter& steps,
                 Points& points) {
    constexpr std::size_t kTogether = 1 << 13;
    static_assert(std::int32_t(RELIDAR_NO_INSTANCE) == -1);
    const std::size_t n = returned_points.size();
    points.position_m.resize(n), points.intensity.resize(n), points.ring.resize(n);
    points.time_offset_s.resize(n), points.instance.resize(n);
    for_each_range_parallel(n, kTogether, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const shared::ReturnedPoint& point = returned_points[i];
            points.position_m[i] = point.position;
            points.intensity[i] = steps.round_to_step(point.intensity);
            points.ring[i] = std::uint16_t(point.ring);
            points.time_offset_s[i] = point.time_offset_s;
            points.instance[i] = std::int32_t(point.instance);
        }
    });
}

}  // namespace

/// Records GPU commands that render a sweep and compute its points.
PendingPoints ScanRenderer::Impl::record_points(const Sweep& sweep, const Pose& dataset_from_points,
                                                const ScanPlan& plan, Send when) try {
    const int side_by_side = sweeps.layout().blocks.empty() ? lanes->most() : 1;
    const bool joins = side_by_side > 1 && (lanes->has_batch() || when == Send::with_next);
    RenderLane& lane = joins ? lanes->next() : lanes->first();
    load_scene(lane, sweep);
    const bool corrects_drops = plan.network == ScanPlan::Network::device;
    PendingPoints scan{
        .rays = record(lane, sweep, sweep.rays(), corrects_drops),
        .dataset_from_sensor = shift_track(sweep.world_from_sensor, sweeps.log().world_offset_m),
        .dataset_from_points = dataset_from_points,
        .time_s = sweep.time_s,
        .max_range_m = compute_seen_by_log(sweep.sensor).max_range_m,
        .step = settings.scatter[std::size_t(sweep.sensor.lidar)].step,
        .renderer = &lanes->renderer(lane)};
    const PoseTrack points_from_sensor =
        convert_track_to_frame(scan.dataset_from_sensor, dataset_from_points);
    scan.points = lane.points.record(scan.renderer->stream(), *scan.rays,
                                     {.points_from_sensor = points_from_sensor,
                                      .time_s = sweep.time_s,
                                      .of_image = config.render.points != "median",
                                      .refined = corrects_drops},
                                     scan.renderer->forward_pass().pass_cap_count());
    if (!joins) scan.renderer->stream().submit();
    else if (when == Send::now) lanes->submit_batch();
    return scan;
} catch (...) {
    wait_for_device();  // because the next scan may replace arrays that recorded commands use
    throw;
}

/// Waits for the points of a requested scan.
RenderedPoints ScanRenderer::Impl::collect(PendingPoints& scan, Points memory) {
    if (scan.ready) return std::move(*scan.ready);
    lanes->submit_batch();
    const PointsOnDevice::Gathered gathered = PointsOnDevice::wait(scan.renderer->stream(), *scan.points);
    if (gathered.n_capped > 0) scan.renderer->check_pass_cap();
    const RayTable& rays = scan.rays->table();
    IntensityScatter steps;
    steps.step = scan.step;
    RenderedPoints result{std::move(memory), rays.size()};
    result.points.return_number.clear(), result.points.firing.clear(), result.points.channels.clear();
    result.points.world_from_points = scan.dataset_from_points;
    result.points.time_s = scan.time_s;
    copy_points(gathered.points, steps, result.points);
    if (settings.coverage.empty()) return result;
    const auto ray_at = [&](std::size_t index) {
        const std::size_t i = PointsOnDevice::get_sampled_ray(index, rays.size());
        return LookingRay{scan.dataset_from_sensor.at(scan.time_s + double(rays.time_offset_s[i])),
                          glm::dvec3(rays.origin[i]), glm::dvec3(rays.direction[i]),
                          gathered.requested_m[index]};
    };
    result.unseen_share =
        relidar::compute_unseen_share(gathered.requested_m.size(), ray_at,
                                      {settings.coverage, sweeps.log().world_offset_m, scan.max_range_m});
    return result;
}

/// Waits until all submitted scans are finished, and stores their points for later calls
/// of wait_for_points().
void ScanRenderer::Impl::finish_pending() {
    for (PendingPoints& scan : pending) scan.ready = collect(scan);
}

void ScanRenderer::submit_points(const SensorChoice& sensor, const ScanRequest& request, double points_at_s,
                                 std::optional<std::uint64_t> sample, Send mode) {
    Impl& s = *impl_;
    if (s.pending.size() >= kScansInFlight)
        throw UsageError(fmt::format(
            "cannot request the points of another scan: {} requested scans were not read, expected "
            "fewer than {}",
            s.pending.size(), kScansInFlight));
    const Sweep sweep = s.sweeps.make(sensor, request);
    const Pose dataset_from_points = request.dataset_from_sensor.at(points_at_s);
    const ScanPlan plan = s.plan(sweep, sample.has_value());
    if (plan.points_on_device) {
        s.pending.push_back(s.record_points(sweep, dataset_from_points, plan, mode));
        return;
    }
    const RenderedScan scan = s.render(sweep, sample);
    s.pending.push_back({.ready = RenderedPoints{place_points(scan, s.config, dataset_from_points),
                                                 scan.image.range_m.size(), scan.unseen_share}});
}

RenderedPoints ScanRenderer::wait_for_points(Points memory) {
    Impl& s = *impl_;
    if (s.pending.empty())
        throw UsageError(
            "cannot read the points of a scan: no scan was requested; call submit_points() first");
    PendingPoints first = std::move(s.pending.front());
    s.pending.pop_front();
    return s.collect(first, std::move(memory));
}

/// Waits until the device no longer uses the arrays of this object. First submits the
/// commands that are recorded but not submitted yet.
void ScanRenderer::Impl::wait_for_device() noexcept {
    try {
        lanes->submit_batch();
        if (scene.is_loaded()) scene.renderer().stream().finish();
    } catch (const Error&) {  // nothing to do, because a lost device no longer writes to memory
    }
}

ScanRenderer::~ScanRenderer() { impl_->wait_for_device(); }

}  // namespace relidar
