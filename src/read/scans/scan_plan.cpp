// SPDX-License-Identifier: Apache-2.0
#include "read/scans/scan_plan.hpp"

#include <algorithm>

#include "base/fail.hpp"
#include "base/median.hpp"
#include "read/scans/point_times.hpp"

namespace relidar::read {
namespace {

// The slowest spinning LiDARs of vehicles make five revolutions per second. If scans are
// farther apart, the log has only some of the scans.
constexpr double kLongestPeriod_s = 0.25;

/// Sets ring numbers of points that have none. If only their order in the files shows the
/// rings, the plan gets `ring_order`, which numbers the rings of all scans.
/// @return false if neither the elevations nor the order show the rings
bool add_rings(ScanPlan& plan, std::vector<LidarPoints>& samples) {
    // Elevations are tried first. The order fails for Ouster LiDARs, because their rings
    // begin at different azimuths.
    const std::vector<Beam> beams = estimate_beams(samples);
    if (!beams.empty()) {
        for (LidarPoints& sample : samples) assign_rings(sample, beams);
        return true;
    }
    const RingOrderDetector order(samples);
    if (!order.is_ring_by_ring()) return false;
    for (LidarPoints& sample : samples) order.number_rings(sample);
    plan.ring_order = order;
    return true;
}

/// Fits the beams of a spinning LiDAR to the samples. Sets the sensor of the plan, or the
/// reason why the points cannot be rays of such a sensor.
void fit_sensor(ScanPlan& plan, std::vector<LidarPoints>& samples) {
    if (!plan.has_rings && !add_rings(plan, samples)) {
        plan.why_no_beams =
            "the points have no rings, and neither their order nor their elevations show the rings";
        return;
    }
    FittedSensor fit;
    try {
        fit = fit_spinning_sensor(samples, plan.sensor.period_s);
        if (fit.sensor.beams.size() * std::size_t(fit.sensor.columns) > kMaxRays)
            fail("the fitted sensor has {} beams and {} columns, expected at most {} rays",
                 fit.sensor.beams.size(), fit.sensor.columns, kMaxRays);
    } catch (const DataError& error) {
        plan.why_no_beams = error.what();
        plan.is_contradiction = true;
        return;
    }
    plan.why_no_beams = why_not_spinning(samples, fit.sensor, plan.sensor.period_s);
    if (plan.why_no_beams.empty() && !plan.has_rings) plan.why_no_beams = why_thinned(samples, fit.sensor);
    if (!plan.why_no_beams.empty()) return;
    // Points do not show these properties.
    fit.sensor.name = plan.sensor.name;
    fit.sensor.min_range_m = plan.sensor.min_range_m;
    fit.sensor.max_range_m = plan.sensor.max_range_m;
    fit.sensor.divergence_rad = plan.sensor.divergence_rad;
    plan.sensor = std::move(fit.sensor);
    plan.beam_of_ring = std::move(fit.beam_of_ring);
    plan.has_beams = plan.is_fitted = true;
}

/// Sets rings for the recovery of firing times, if the points have none.
void number_rings(const FiringPlan& plan, LidarPoints& points) {
    if (!points.ring.empty()) return;
    if (plan.ring_order) plan.ring_order->number_rings(points);
    else if (!plan.beams.empty()) assign_rings(points, plan.beams);
}

}  // namespace

void FiringPlan::restore(LidarPoints& points, double frame_time_s) const {
    const bool has_rings = !points.ring.empty();
    number_rings(*this, points);
    if (points.ring.empty()) return;  // the reader reports the missing rings
    restore_firings(points, recovery, frame_time_s);
    if (!has_rings) points.ring.clear();
}

std::optional<FiringPlan> plan_firings(std::vector<CompensatedSweep> sweeps,
                                       const CompensatedSensor& sensor) {
    const auto n_without_rings = std::ranges::count_if(
        sweeps, [](const CompensatedSweep& sweep) { return sweep.points.ring.empty(); });
    const bool are_alike = n_without_rings == 0 || n_without_rings == std::ssize(sweeps);
    if (!are_alike) return std::nullopt;  // Stored and found ring numbers would be mixed.
    FiringPlan plan;
    if (n_without_rings > 0) {
        std::vector<LidarPoints> samples;
        for (const CompensatedSweep& sweep : sweeps) samples.push_back(sweep.points);
        // Motion compensation changes the elevations, but not the order of the points.
        const RingOrderDetector order(samples);
        if (order.is_ring_by_ring()) plan.ring_order = order;
        else plan.beams = estimate_beams(samples);
        if (!plan.ring_order && plan.beams.empty()) return std::nullopt;
        for (CompensatedSweep& sweep : sweeps) number_rings(plan, sweep.points);
    }
    std::optional<FiringRecovery> recovery = find_firings(sweeps, sensor);
    if (!recovery) return std::nullopt;
    plan.recovery = std::move(*recovery);
    return plan;
}

TimeLimits find_time_limits(const std::vector<LidarPoints>& samples, double sweep_s) {
    constexpr double kOffsetMargin = 1.5;
    std::vector<double> spans_s;
    for (const LidarPoints& points : samples) spans_s.push_back(sweep_span_s(points));
    const double span_s = spans_s.empty() ? 0.0 : compute_median(std::move(spans_s));
    const double longest_offset_s = kOffsetMargin * std::max(span_s, sweep_s);
    return {longest_offset_s, middle_time_s(samples, longest_offset_s)};
}

std::optional<double> median_step_s(const Log& log, int lidar_index) {
    std::vector<double> steps_s;
    std::optional<double> before_s;  // time of the frame before
    for (const Frame& frame : log.frames) {
        if (frame.lidar != lidar_index) continue;
        if (before_s && frame.time_s > *before_s) steps_s.push_back(frame.time_s - *before_s);
        before_s = frame.time_s;
    }
    return steps_s.empty() ? std::nullopt : std::optional(compute_median(std::move(steps_s)));
}

double estimate_sweep_s(const Log& log, int lidar_index) {
    const double step_s = median_step_s(log, lidar_index).value_or(kUsualPeriod_s);
    return step_s > kLongestPeriod_s ? step_s / std::round(step_s / kUsualPeriod_s) : step_s;
}

void plan_rays(ScanPlan& plan, const LidarScanLayout& layout, double sweep_s,
               std::vector<LidarPoints> samples) {
    plan.has_rings = samples.empty() || !samples[0].ring.empty();
    plan.has_times = samples.empty() || !samples[0].time_offset_s.empty();
    if (plan.sensor.period_s == 0.0 || !layout.has_beams) plan.sensor.period_s = sweep_s;
    if (layout.has_beams) {
        plan.has_beams = true;
        const std::size_t n = plan.sensor.beams.size();
        for (std::size_t ring = 0; ring < n; ++ring)
            // Beams are sorted from the highest to the lowest.
            plan.beam_of_ring.push_back(std::uint16_t(layout.lowest_first ? n - 1 - ring : ring));
    } else if (layout.spins && !samples.empty()) {
        fit_sensor(plan, samples);
    }
    if (!plan.has_beams) plan.sensor.period_s = 0.0;  // The sensor does not rotate.
}

}  // namespace relidar::read
