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
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

/// Copies points that the device computed to the arrays of `Points`.
void copy_points(std::span<const shared::ReturnedPoint> from, const IntensityScatter& steps, Points& to) {
    constexpr std::size_t kTogether = 1 << 13;
    static_assert(std::int32_t(RELIDAR_NO_INSTANCE) == -1);
    const std::size_t n = from.size();
    to.position_m.resize(n), to.intensity.resize(n), to.ring.resize(n);
    to.time_offset_s.resize(n), to.instance.resize(n);
    for_each_part(n, kTogether, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) {
            const shared::ReturnedPoint& point = from[i];
            to.position_m[i] = point.position;
            to.intensity[i] = steps.quantised(point.intensity);
            to.ring[i] = std::uint16_t(point.ring);
            to.time_offset_s[i] = point.time_offset_s;
            to.instance[i] = std::int32_t(point.instance);
        }
    });
}

}  // namespace

/// Returns true if the device, and not the host, computes the points of this sensor's
/// scans.
bool ScanRenderer::Impl::gathers_points(const SensorChoice& sensor, bool sampled) const {
    const SensorConfig own = config_of(sensor);
    return !sampled && weather.clear() && wanted.empty() && !sensor.grid && own.sub_rays == 1 &&
           own.returns == 1 && sensor.rays.size() > 0;
}

/// Selects the rendering resources for the next scan that is submitted together with
/// others. Creates the resources at the first call.
ScanStrand& ScanRenderer::Impl::next_strand() {
    if (!together) {
        while (1 + std::ssize(others) < most_strands) {
            try {
                others.emplace_back(device).copy = scene.copy();
                // device memory is exhausted, so fewer copies of the scene are used
            } catch (const DeviceError&) {
                others.pop_back();
                most_strands = 1 + int(others.size());
            }
        }
        together.emplace(scene.renderer().stream(), 1 + others.size());
        n_together = 0;
    }
    const std::size_t strand = n_together++ % (1 + others.size());
    together->choose(strand);
    return strand == 0 ? first : others[strand - 1];
}

/// Submits the GPU commands of all scans that were recorded together.
void ScanRenderer::Impl::send() {
    if (!together) return;
    together.reset();
    scene.renderer().stream().submit();
}

void ScanRenderer::ask_points(const SensorChoice& sensor, const ScanRequest& request, double points_at_s,
                              std::optional<std::uint64_t> sample, Send when) {
    Impl& s = *impl_;
    if (s.asked.size() >= kScansInFlight)
        throw UsageError(fmt::format(
            "cannot request the points of another scan: {} requested scans were not read, expected "
            "fewer than {}",
            s.asked.size(), kScansInFlight));
    AskedPoints asked;
    if (!s.gathers_points(sensor, sample.has_value())) {
        const RenderedScan scan = render(sensor, request, sample);
        asked.ready =
            RenderedPoints{place_points(scan, s.config, request.dataset_from_sensor.at(points_at_s)),
                           scan.image.range_m.size(), scan.unseen_share};
        s.asked.push_back(std::move(asked));
        return;
    }
    std::vector<InstancePose> placed = drive(sensor, request);
    asked.dataset_from_points = request.dataset_from_sensor.at(points_at_s);
    const bool joins = side_by_side() > 1 && (s.together || when == Send::with_next);
    ScanStrand& strand = joins ? s.next_strand() : s.first;
    s.bring(strand, sensor, request.time_s, std::move(placed));
    asked.renderer = &s.renderer_of(strand);
    Stream& stream = asked.renderer->stream();
    const bool refined = s.refines_rays(sensor, sensor.rays);
    const std::optional<RayTable> of_now = s.rays_of_scan(sensor, request.time_s);
    const Impl::Cast cast = s.record(strand, sensor, of_now ? *of_now : sensor.rays, request.time_s, refined);
    asked.rays = cast.rays;
    asked.dataset_from_sensor = shifted_track(cast.track, s.sweep.world_offset_m);
    asked.time_s = request.time_s;
    asked.max_range_m = std::min(sensor.limits.max_m, double(s.config.dataset.max_range_m));
    asked.step = s.scatter[std::size_t(sensor.lidar)].step;
    const PoseTrack points_from_sensor = seen_from(asked.dataset_from_sensor, asked.dataset_from_points);
    asked.points = strand.points.record(stream, *cast.rays,
                                        {.points_from_sensor = points_from_sensor,
                                         .time_s = request.time_s,
                                         .of_image = s.config.render.points != "median",
                                         .refined = refined},
                                        asked.renderer->forward_pass().pass_cap_count());
    s.asked.push_back(std::move(asked));
    if (!joins) stream.submit();
    else if (when == Send::now) s.send();
}

/// Waits for the points of a requested scan.
RenderedPoints ScanRenderer::Impl::points_of(AskedPoints& scan, Points memory) {
    if (scan.ready) return std::move(*scan.ready);
    send();
    const PointsOnDevice::Gathered gathered = PointsOnDevice::wait(scan.renderer->stream(), *scan.points);
    if (gathered.n_capped > 0) scan.renderer->check_passes();
    const RayTable& rays = scan.rays->table();
    IntensityScatter steps;
    steps.step = scan.step;
    RenderedPoints result{std::move(memory), rays.size()};
    result.points.return_number.clear(), result.points.firing.clear(), result.points.channels.clear();
    result.points.world_from_points = scan.dataset_from_points;
    result.points.time_s = scan.time_s;
    copy_points(gathered.points, steps, result.points);
    if (coverage.empty()) return result;
    const auto ray_at = [&](std::size_t k) {
        const std::size_t i = PointsOnDevice::asked_ray(k, rays.size());
        return LookingRay{scan.dataset_from_sensor.at(scan.time_s + double(rays.time_offset_s[i])),
                          glm::dvec3(rays.origin[i]), glm::dvec3(rays.direction[i]), gathered.asked_m[k]};
    };
    result.unseen_share = relidar::unseen_share(gathered.asked_m.size(), ray_at,
                                                {coverage, sweep.world_offset_m, scan.max_range_m});
    return result;
}

/// Waits until all requested scans are finished. Stores their points until they are
/// collected.
void ScanRenderer::Impl::settle() {
    // If a request failed after recording had begun, its scan is not in `asked`.
    // Therefore this also waits for the device.
    if (together) {
        send();
        scene.renderer().stream().finish();
    }
    for (AskedPoints& scan : asked) scan.ready = points_of(scan);
}

ScanRenderer::~ScanRenderer() {
    const auto in_flight = [](const AskedPoints& scan) { return !scan.ready; };
    if (std::ranges::none_of(impl_->asked, in_flight)) return;
    try {
        impl_->send();
        // the device may still write to memory that this object frees
        impl_->scene.renderer().stream().finish();
    } catch (const DeviceError&) {  // a lost device no longer writes
    }
}

RenderedPoints ScanRenderer::take_points(Points memory) {
    Impl& s = *impl_;
    if (s.asked.empty())
        throw UsageError("cannot read the points of a scan: no scan was requested; call ask_points() first");
    AskedPoints first = std::move(s.asked.front());
    s.asked.pop_front();
    return s.points_of(first, std::move(memory));
}

}  // namespace relidar
