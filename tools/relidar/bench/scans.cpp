// SPDX-License-Identifier: Apache-2.0
#include "bench/scans.hpp"

#include <algorithm>
#include <chrono>
#include <ctime>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bench/measure.hpp"
#include "interrupt.hpp"
#include <relidar/error.hpp>
#include <relidar/render.hpp>
#include <relidar/run.hpp>

namespace relidar::cli {
namespace {

constexpr int kMostInOneGo = 1'000'000;

/// The log's own way, and moments on it.
class Drive {
public:
    Drive(const Run& run, int n_scans)
        : track_(shifted_track(run.sequence.world_from_sensor(0), run.sequence.world_offset_m)),
          first_s_(track_.time_s.front()),
          last_s_(track_.time_s.back()),
          n_(n_scans) {}
    ScanRequest at(int scan) const { return {first_s_ + (last_s_ - first_s_) * (scan + 0.5) / n_, track_}; }

private:
    PoseTrack track_;
    double first_s_, last_s_;
    int n_;
};

double kernel_ms(const KernelTimes& times) {
    double sum = 0.0;
    for (const auto& [kernel, total] : times.totals) sum += total.ms;
    return sum;
}

/// Processor time that this thread has had.
double thread_ms() {
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * double(t.tv_sec) + 1e-6 * double(t.tv_nsec);
}

}  // namespace

ScanTimes measure_scans(Device& device, const ScanBench& bench) {
    if (bench.n_scans < 1 || bench.n_scans > kMostInOneGo)
        throw UsageError(fmt::format("--scans: found {}, expected 1 to {}", bench.n_scans, kMostInOneGo));
    const Run run = load_run(bench.run);
    const SensorChoice sensor = choose_sensor(bench.sensor.empty() ? "native" : bench.sensor, run.config, run.sequence);
    ScanRenderer renderer(device, run);
    const Drive drive(run, bench.n_scans);
    const auto ask = [&](int scan) {
        const ScanRequest request = drive.at(scan);
        renderer.ask_points(sensor, request, request.time_s, bench.sampled ? std::optional<std::uint64_t>(scan) : std::nullopt);
    };
    ask(0);
    ScanTimes result{.sensor = sensor.name, .n_scans = bench.n_scans, .rays = renderer.take_points().n_rays};
    const double kernels_before_ms = kernel_ms(renderer.times());
    std::vector<double> scan_ms;
    const auto start = std::chrono::steady_clock::now();
    const double thread_begun_ms = thread_ms();
    PointScan scan;
    ask(0);
    for (int i = 0; i < bench.n_scans; ++i) {
        stop_if_interrupted();
        const auto begun = std::chrono::steady_clock::now();
        if (i + 1 < bench.n_scans) ask(i + 1);   // the device has work while the points of this one are taken
        scan = renderer.take_points(std::move(scan.points));
        result.points += double(scan.points.size()) / bench.n_scans;
        scan_ms.push_back(ms_since(begun));
    }
    result.host_ms = (thread_ms() - thread_begun_ms) / bench.n_scans;
    result.scans_per_s = 1e3 * bench.n_scans / ms_since(start);
    result.scan_ms = spread_of(scan_ms).median;
    result.device_ms = (kernel_ms(renderer.times()) - kernels_before_ms) / bench.n_scans;
    return result;
}

std::string scans_text(const ScanTimes& t) {
    return fmt::format("{}: {} scans of {} rays, {:.0f} points each\n"
                       "{:.1f} scans/s, {:.2f} ms a scan (median), of it kernels {:.2f}; the thread that asks works {:.2f}\n",
                       t.sensor, t.n_scans, t.rays, t.points, t.scans_per_s, t.scan_ms, t.device_ms, t.host_ms);
}

std::string scans_json(const ScanTimes& t, const Device& device, const std::string& command_line) {
    const nlohmann::ordered_json json = {{"format", "relidar bench scans"}, {"version", 1},
                                         {"relidar", RELIDAR_VERSION},      {"command", command_line},
                                         {"device", device.info().name},    {"sensor", t.sensor},
                                         {"scans", t.n_scans},              {"rays", t.rays},
                                         {"points", t.points},              {"scans_per_s", t.scans_per_s},
                                         {"scan_ms", t.scan_ms},            {"kernels_ms", t.device_ms},
                                         {"host_ms", t.host_ms}};
    return json.dump(1) + "\n";
}

}  // namespace relidar::cli
