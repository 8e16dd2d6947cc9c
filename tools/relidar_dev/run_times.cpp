// SPDX-License-Identifier: Apache-2.0
#include "run_times.hpp"

#include <algorithm>
#include <ctime>
#include <functional>
#include <vector>

#include <fmt/format.h>

#include <relidar/score/evaluation.hpp>
#include "base/fail.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "measure.hpp"
#include "options.hpp"
#include "render/selection.hpp"

namespace relidar::cli {
namespace {

constexpr int kMostInOneGo = 1'000'000;
// Maximum number of scans per group. It is half the limit of the renderer, so that the
// device can render the next group while a finished group is read.
constexpr int kMostTogether = int(ScanRenderer::kScansInFlight) / 2;

/// Makes scan requests at evenly spaced times ("moments") along the recorded path of the
/// log's LiDAR. Moments are the middles of n_moments_ equal parts of the time of the log.
/// Request k is the scan of sensor k % n_sensors() at moment k / n_sensors().
class LogPathRequests {
public:
    LogPathRequests(const Run& run, const ScanBenchOptions& bench)
        : sensors_(list_sensors(bench.sensor.empty() ? "native" : bench.sensor, read_sensor_rig(bench.sensor),
                                run, 0)),
          n_moments_((bench.n_scans - 1) / n_sensors() + 1) {
        const PoseTrack log = shift_track(run.log.lidar_track(0), run.log.world_offset_m);
        first_s_ = log.time_s.front();
        last_s_ = log.time_s.back();
        for (const RenderedSensor& sensor : sensors_)
            tracks_.push_back(mount_track(subdivide_turns(log), sensor.mounting));
    }
    int n_sensors() const { return int(sensors_.size()); }
    const SimulatedSensor& sensor_of(int scan_index) const {
        return sensors_[std::size_t(scan_index % n_sensors())].sensor;
    }
    ScanRequest make_request(int scan_index) const {
        const int moment = scan_index / n_sensors();
        return {first_s_ + (last_s_ - first_s_) * (moment + 0.5) / n_moments_,
                tracks_[std::size_t(scan_index % n_sensors())]};
    }

private:
    std::vector<RenderedSensor> sensors_;
    int n_moments_;
    std::vector<PoseTrack> tracks_;
    double first_s_, last_s_;
};

double sum_kernel_ms(const KernelTimes& kernel_times) {
    double sum = 0.0;
    for (const auto& [kernel, total] : kernel_times.totals) sum += total.ms;
    return sum;
}

double thread_cpu_ms() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * double(t.tv_sec) + 1e-6 * double(t.tv_nsec);
}

}  // namespace

ScanBenchTimes measure_scans(Device& device, const ScanBenchOptions& options) {
    using Timing = ScanRenderer::SubmissionTiming;
    if (options.n_scans < 1 || options.n_scans > kMostInOneGo)
        fail<UsageError>("--scans: found {}, expected a number from 1 to {}", options.n_scans, kMostInOneGo);
    if (options.together < 0 || options.together > kMostTogether)
        fail<UsageError>("--together: found {}, expected a number from 1 to {}", options.together,
                         kMostTogether);
    const Run run = load_run(options.run);
    ScanRenderer renderer(device, run);
    const LogPathRequests drive(run, options);
    const int together = std::min(options.together ? options.together : drive.n_sensors(),
                                  std::min(kMostTogether, options.n_scans));
    // Submits a group of scans together and returns its size.
    const auto submit_group = [&](int first_scan) {
        const int end = std::min(first_scan + together, options.n_scans);
        for (int scan = first_scan; scan < end; ++scan) {
            const ScanRequest request = drive.make_request(scan);
            const bool is_last = scan + 1 == end;
            renderer.submit_points(drive.sensor_of(scan), request, request.time_s, std::nullopt,
                                   is_last ? Timing::now : Timing::with_next);
        }
        return end - first_scan;
    };
    // Does not measure the first scans, because they allocate memory.
    for (int n = submit_group(0); n > 0; --n) renderer.wait_for_points();

    ScanBenchTimes result{.sensor = drive.n_sensors() > 1 ? options.sensor : drive.sensor_of(0).name,
                          .n_scans = options.n_scans,
                          .together = together,
                          .side_by_side = std::min(together, renderer.max_parallel())};
    const double kernels_before_ms = sum_kernel_ms(renderer.times());
    std::vector<double> scan_ms;  // mean time of a scan, for each group
    const auto start = Clock::now();
    const double cpu_before_ms = thread_cpu_ms();
    RenderedPoints scan;
    int n_submitted = submit_group(0), n_in_flight = n_submitted;
    while (n_in_flight > 0) {
        check_interrupt();
        const auto group_start = Clock::now();
        const int n_to_read = n_in_flight;
        // Submits scans before it reads finished ones, so that the device has work.
        n_in_flight = n_submitted < options.n_scans ? submit_group(n_submitted) : 0;
        n_submitted += n_in_flight;
        for (int i = 0; i < n_to_read; ++i) {
            scan = renderer.wait_for_points(std::move(scan.points));
            result.points += double(scan.points.size()) / options.n_scans;
            result.rays += double(scan.n_rays) / options.n_scans;
        }
        scan_ms.push_back(ms_since(group_start) / n_to_read);
    }
    result.host_ms = (thread_cpu_ms() - cpu_before_ms) / options.n_scans;
    result.scans_per_s = 1e3 * options.n_scans / ms_since(start);
    result.scan_ms = percentiles_of(scan_ms).median;
    result.device_ms = (sum_kernel_ms(renderer.times()) - kernels_before_ms) / options.n_scans;
    return result;
}

std::string format_scans(const ScanBenchTimes& times) {
    std::string groups;
    if (times.together > 1)
        groups = fmt::format(", {} submitted together, {} rendered in parallel", times.together,
                             times.side_by_side);
    return fmt::format(
        "{}: {} scans of {:.0f} rays, {:.0f} points each{}\n"
        "{:.1f} scans/s, {:.2f} ms per scan (median); kernels {:.2f} ms per scan; processor time of the "
        "calling thread {:.2f} ms per scan\n",
        times.sensor, times.n_scans, times.rays, times.points, groups, times.scans_per_s, times.scan_ms,
        times.device_ms, times.host_ms);
}

TrainingStepTimes measure_steps(Device& device, const std::string& folder, int n_steps, bool quiet) {
    Run run = load_run(folder);
    copy_scans(run, run.split.train, load_dataset(run.config, quiet));
    TrainingStepTimes times = measure_steps(device, run, n_steps, is_interrupted);
    check_interrupt();
    return times;
}

std::string format_steps(const TrainingStepTimes& times, const Device& device) {
    // The slowest kernel is first.
    using KernelTimeRow = std::pair<std::string, TrainingStepTimes::StepKernelTime>;
    std::vector<KernelTimeRow> kernels(times.kernels.begin(), times.kernels.end());
    std::ranges::sort(kernels, std::greater{}, [](const KernelTimeRow& row) { return row.second.ms; });
    std::string text = fmt::format(
        "{}\n{} surfels, {} rays per step, {} hits stored per ray; means of {} "
        "steps\n\n{:<28}{:>9}{:>10}{:>8}\n",
        device.info().name, times.surfels, times.rays, times.stored_hits_per_ray, times.n_steps, "kernel",
        "launches", "ms", "share");
    const auto add_line = [&](const std::string& name, const std::string& launches, double ms) {
        text +=
            fmt::format("{:<28}{:>9}{:>10.3f}{:>7.1f}%\n", name, launches, ms, 100.0 * ms / times.wall_ms);
    };
    for (const auto& [name, kernel] : kernels)
        add_line(name, fmt::format("{:.3g}", kernel.launches), kernel.ms);
    if (kernels.empty())
        text += "The times of the kernels are unknown, because the device has no timestamps.\n";
    else add_line("between kernels", "", times.compute_idle_ms());
    add_line("step, wall time", "", times.wall_ms);
    return text + fmt::format("{:.2f} steps/s\n", 1e3 / times.wall_ms);
}

}  // namespace relidar::cli
