// SPDX-License-Identifier: Apache-2.0
#include "scans.hpp"

#include <algorithm>
#include <chrono>
#include <ctime>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include "base/fail.hpp"
#include "interrupt.hpp"
#include "measure.hpp"

namespace relidar::cli {
namespace {

constexpr int kMostInOneGo = 1'000'000;
// Maximum number of scans per group. It is half the limit of the renderer, so that the
// device can render the next group while a finished group is read.
constexpr int kMostTogether = int(ScanRenderer::kScansInFlight) / 2;

/// Makes scan requests at evenly spaced times along the recorded path of the log's LiDAR.
/// If a rig has several sensors, consecutive requests use one sensor after the other.
class LogPathRequests {
public:
    LogPathRequests(const TrainedRun& run, const ScanBenchOptions& bench) {
        const PoseTrack log =
            add_offset_to_track_positions(run.sequence.get_world_from_sensor(0), run.sequence.world_offset_m);
        first_s_ = log.time_s.front();
        last_s_ = log.time_s.back();
        if (const auto rig = read_sensor_rig(bench.sensor)) {
            for (const MountedSensor& mounted : *rig) {
                sensors_.push_back(make_simulated_sensor(mounted));
                tracks_.push_back(
                    compute_mounted_track(subdivide_turning_segments(log), mounted.rig_from_sensor));
            }
        } else {
            sensors_.push_back(find_or_load_sensor(bench.sensor.empty() ? "native" : bench.sensor, run.config,
                                                   run.sequence));
            tracks_.push_back(log);
        }
        n_moments_ = (bench.n_scans - 1) / n_sensors() + 1;
    }
    int n_sensors() const { return int(sensors_.size()); }
    const SimulatedSensor& get_sensor_of_scan(int scan_index) const {
        return sensors_[std::size_t(scan_index % n_sensors())];
    }
    ScanRequest make_scan_request(int scan_index) const {
        const int moment = scan_index / n_sensors();
        return {first_s_ + (last_s_ - first_s_) * (moment + 0.5) / n_moments_,
                tracks_[std::size_t(scan_index % n_sensors())]};
    }

private:
    std::vector<SimulatedSensor> sensors_;
    std::vector<PoseTrack> tracks_;
    double first_s_, last_s_;
    int n_moments_;
};

double sum_kernel_ms(const KernelTimes& kernel_times) {
    double sum = 0.0;
    for (const auto& [kernel, total] : kernel_times.totals) sum += total.ms;
    return sum;
}

double get_thread_cpu_time_ms() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * double(t.tv_sec) + 1e-6 * double(t.tv_nsec);
}

}  // namespace

ScanBenchTimes measure_scan_times(Device& device, const ScanBenchOptions& bench_options) {
    using Send = ScanRenderer::SubmissionTiming;
    if (bench_options.n_scans < 1 || bench_options.n_scans > kMostInOneGo)
        fail<UsageError>("--scans: found {}, expected a number from 1 to {}", bench_options.n_scans,
                         kMostInOneGo);
    if (bench_options.together < 0 || bench_options.together > kMostTogether)
        fail<UsageError>("--together: found {}, expected a number from 1 to {}", bench_options.together,
                         kMostTogether);
    const TrainedRun run = load_run(bench_options.run);
    ScanRenderer renderer(device, run);
    const LogPathRequests drive(run, bench_options);
    const int together = std::min(bench_options.together ? bench_options.together : drive.n_sensors(),
                                  std::min(kMostTogether, bench_options.n_scans));
    const auto ask = [&](int first) {
        const int end = std::min(first + together, bench_options.n_scans);
        for (int scan = first; scan < end; ++scan) {
            const ScanRequest request = drive.make_scan_request(scan);
            renderer.submit_points(drive.get_sensor_of_scan(scan), request, request.time_s,
                                   bench_options.sampled ? std::optional<std::uint64_t>(scan) : std::nullopt,
                                   scan + 1 < end ? Send::with_next : Send::now);
        }
        return end - first;
    };
    for (int n = ask(0); n > 0; --n) renderer.wait_for_points();
    ScanBenchTimes result{
        .sensor = drive.n_sensors() > 1 ? bench_options.sensor : drive.get_sensor_of_scan(0).name,
        .n_scans = bench_options.n_scans,
        .together = together,
        .side_by_side = std::min(together, renderer.get_max_parallel_scans())};
    const double kernels_before_ms = sum_kernel_ms(renderer.times());
    std::vector<double> scan_ms;
    const auto start = std::chrono::steady_clock::now();
    const double thread_begun_ms = get_thread_cpu_time_ms();
    RenderedPoints scan;
    for (int first = 0, n_requested = ask(0); n_requested > 0;) {
        throw_if_interrupted();
        const auto begun = std::chrono::steady_clock::now();
        const int n_scans = n_requested;
        first += n_scans;
        // Submits the next scans before it reads the finished scans, so that the device
        // always has work.
        n_requested = first < bench_options.n_scans ? ask(first) : 0;
        for (int i = 0; i < n_scans; ++i) {
            scan = renderer.wait_for_points(std::move(scan.points));
            result.points += double(scan.points.size()) / bench_options.n_scans;
            result.rays += double(scan.n_rays) / bench_options.n_scans;
        }
        scan_ms.push_back(measure_ms_since(begun) / n_scans);
    }
    result.host_ms = (get_thread_cpu_time_ms() - thread_begun_ms) / bench_options.n_scans;
    result.scans_per_s = 1e3 * bench_options.n_scans / measure_ms_since(start);
    result.scan_ms = compute_p10_median_p90(scan_ms).median;
    result.device_ms = (sum_kernel_ms(renderer.times()) - kernels_before_ms) / bench_options.n_scans;
    return result;
}

std::string format_scan_times(const ScanBenchTimes& times) {
    return fmt::format(
        "{}: {} scans of {:.0f} rays, {:.0f} points each{}\n"
        "{:.1f} scans/s, {:.2f} ms per scan (median); kernels {:.2f} ms per scan; processor time of the "
        "calling thread {:.2f} ms per scan\n",
        times.sensor, times.n_scans, times.rays, times.points,
        times.together > 1 ? fmt::format(", {} submitted together, {} rendered in parallel", times.together,
                                         times.side_by_side)
                           : "",
        times.scans_per_s, times.scan_ms, times.device_ms, times.host_ms);
}

std::string make_scan_times_json(const ScanBenchTimes& times, const Device& device,
                                 const std::string& command_line) {
    const nlohmann::ordered_json json = {{"format", "relidar-dev bench scans"},
                                         {"version", 1},
                                         {"relidar", RELIDAR_VERSION},
                                         {"command", command_line},
                                         {"device", device.info().name},
                                         {"sensor", times.sensor},
                                         {"scans", times.n_scans},
                                         {"together", times.together},
                                         {"side_by_side", times.side_by_side},
                                         {"rays", times.rays},
                                         {"points", times.points},
                                         {"scans_per_s", times.scans_per_s},
                                         {"scan_ms", times.scan_ms},
                                         {"kernels_ms", times.device_ms},
                                         {"host_ms", times.host_ms}};
    return json.dump(1) + "\n";
}

}  // namespace relidar::cli
