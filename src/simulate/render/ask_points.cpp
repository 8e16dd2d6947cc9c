// SPDX-License-Identifier: Apache-2.0
// Requests scans and collects their points. The device renders a scan while the host
// processes an earlier scan.
#include <cstdint>
#include <span>

#include <relidar/diff/accel.hpp>
#include <relidar/simulate/place_points.hpp>

#include "base/fail.hpp"
#include "base/parallel.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

void copy_device_points(std::span<const shared::ReturnedPoint> returned_points,
                        const IntensityScatterModel& intensity_scatter, LidarPoints& points) {
    constexpr std::size_t kTogether = 1 << 13;
    static_assert(std::int32_t(RELIDAR_NO_INSTANCE) == -1);
    const std::size_t n = returned_points.size();
    points.position_m.resize(n);
    points.intensity.resize(n);
    points.ring.resize(n);
    points.time_offset_s.resize(n);
    points.instance.resize(n);
    parallel_for_ranges(n, kTogether, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const shared::ReturnedPoint& point = returned_points[i];
            points.position_m[i] = point.position;
            points.intensity[i] = intensity_scatter.quantise_intensity(point.intensity);
            points.ring[i] = std::uint16_t(point.ring);
            points.time_offset_s[i] = point.time_offset_s;
            points.instance[i] = std::int32_t(point.instance);
        }
    });
}

}  // namespace

PendingPoints ScanRenderer::Impl::record_point_rendering_commands(const SimulatedSweep& sweep,
                                                                  const Pose& dataset_from_points,
                                                                  const ScanRenderPlan& plan,
                                                                  SubmissionTiming submit_mode) try {
    const int side_by_side = sweeps.get_scene_layout().blocks.empty() ? lanes->get_parallel_scan_limit() : 1;
    const bool joins =
        side_by_side > 1 && (lanes->has_open_batch() || submit_mode == SubmissionTiming::with_next);
    ParallelScanResources& lane =
        joins ? lanes->get_next_scan_resources_of_batch() : lanes->get_unbatched_scan_resources();
    prepare_scene_for_sweep(lane, sweep);
    const bool corrects_drops = plan.network == ScanRenderPlan::RayDropStage::device;
    PendingPoints scan{.rays = record_trace_commands(lane, sweep, sweep.get_rays(), corrects_drops),
                       .dataset_from_sensor = add_offset_to_track_positions(sweep.world_from_sensor,
                                                                            sweeps.get_log().world_offset_m),
                       .dataset_from_points = dataset_from_points,
                       .time_s = sweep.time_s,
                       .max_range_m = get_space_observed_in_log(sweep.sensor).max_range_m,
                       .shows_background = sweeps.shows_background(),
                       .step = settings.scatter[std::size_t(sweep.sensor.lidar)].step,
                       .renderer = &lanes->get_renderer(lane)};
    const PoseTrack points_from_sensor =
        convert_track_to_frame(scan.dataset_from_sensor, dataset_from_points);
    scan.points = lane.points.record_point_computation_and_readback(
        scan.renderer->stream(), *scan.rays,
        {.points_from_sensor = points_from_sensor,
         .time_s = sweep.time_s,
         .of_image = config.render.points != "median",
         .refined = corrects_drops},
        scan.renderer->forward_pass().get_truncated_ray_count_on_device());
    if (!joins) scan.renderer->stream().submit_commands();
    else if (submit_mode == SubmissionTiming::now) lanes->submit_batched_scan_commands();
    return scan;
} catch (...) {
    wait_for_device();  // waits, because the next scan may replace arrays that recorded commands use
    throw;
}

RenderedPoints ScanRenderer::Impl::collect_points(PendingPoints& pending_points,
                                                  LidarPoints reusable_memory) {
    if (pending_points.ready) return std::move(*pending_points.ready);
    lanes->submit_batched_scan_commands();
    const DevicePointComputer::GatheredPoints gathered = DevicePointComputer::wait_for_copied_points(
        pending_points.renderer->stream(), *pending_points.points);
    if (gathered.n_capped > 0) pending_points.renderer->require_rays_fully_traced();
    const RayTable& rays = pending_points.rays->get_ray_table();
    IntensityScatterModel steps;
    steps.step = pending_points.step;
    RenderedPoints result{std::move(reusable_memory), rays.size()};
    result.points.return_number.clear();
    result.points.firing.clear();
    result.points.channels.clear();
    result.points.world_from_points = pending_points.dataset_from_points;
    result.points.time_s = pending_points.time_s;
    copy_device_points(gathered.points, steps, result.points);
    if (settings.coverage.empty() || !pending_points.shows_background) return result;
    const auto ray_at = [&](std::size_t index) {
        const std::size_t i = DevicePointComputer::get_evenly_sampled_ray_index(index, rays.size());
        return RayWithSurfaceRange{pending_points.dataset_from_sensor.interpolate_pose(
                                       pending_points.time_s + double(rays.time_offset_s[i])),
                                   glm::dvec3(rays.origin[i]), glm::dvec3(rays.direction[i]),
                                   gathered.requested_m[index]};
    };
    result.unseen_share = relidar::compute_fraction_of_unobserved_rays(
        gathered.requested_m.size(), ray_at,
        {settings.coverage, sweeps.get_log().world_offset_m, pending_points.max_range_m});
    return result;
}

void ScanRenderer::Impl::finish_pending_scans() {
    for (PendingPoints& scan : pending) scan.ready = collect_points(scan);
}

void ScanRenderer::submit_points(const SimulatedSensor& sensor, const ScanRequest& request,
                                 double point_frame_time_s, std::optional<std::uint64_t> sample_seed,
                                 SubmissionTiming submission_timing) {
    Impl& s = *impl_;
    if (s.pending.size() >= kScansInFlight)
        fail<UsageError>(
            "{} requested scans have not been read yet, expected fewer than {}: call wait_for_points()",
            s.pending.size(), kScansInFlight);
    const SimulatedSweep sweep = s.sweeps.make_sweep_of_request(sensor, request);
    const Pose dataset_from_points = request.dataset_from_sensor.interpolate_pose(point_frame_time_s);
    const ScanRenderPlan plan = s.plan_steps_for_sweep(sweep, sample_seed.has_value());
    if (plan.points_on_device) {
        s.pending.push_back(
            s.record_point_rendering_commands(sweep, dataset_from_points, plan, submission_timing));
        return;
    }
    const RenderedScan scan = s.render_sweep(sweep, sample_seed);
    s.pending.push_back({.ready = RenderedPoints{convert_scan_to_points(scan, s.config, dataset_from_points),
                                                 scan.image.range_m.size(), scan.unseen_share}});
}

RenderedPoints ScanRenderer::wait_for_points(LidarPoints memory) {
    Impl& s = *impl_;
    if (s.pending.empty())
        throw UsageError(
            "cannot read the points of a scan: no scan was requested; call submit_points() first");
    PendingPoints first = std::move(s.pending.front());
    s.pending.pop_front();
    return s.collect_points(first, std::move(memory));
}

void ScanRenderer::Impl::wait_for_device() noexcept {
    try {
        lanes->submit_batched_scan_commands();
        if (scene.has_loaded_renderer()) scene.renderer().stream().submit_and_wait();
    } catch (const Error&) {  // nothing to do, because a lost device no longer writes to memory
    }
}

ScanRenderer::~ScanRenderer() { impl_->wait_for_device(); }

}  // namespace relidar
