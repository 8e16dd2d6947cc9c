// SPDX-License-Identifier: Apache-2.0
// relidar_bench_drop_network measures the ray-drop network: a training step, an
// inference, the kernels of a training step, and the device memory of training.
#include <algorithm>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include "diff/network/measured_network.hpp"

#include "timing.hpp"

namespace {

using namespace relidar;

template <class Work>
double measure_median_time_ms(int n_repeats, Work&& work) {
    work();  // Warm-up run, not timed.
    std::vector<double> ms;
    for (int i = 0; i < n_repeats; ++i) ms.push_back(measure_wall_time_ms(work));
    return median(ms);
}

/// Prints the total time of each kernel in a training step, the slowest kernel first.
void print_kernel_times(const KernelTimes& kernel_times, int n_steps) {
    std::vector<std::pair<double, std::string>> rows;
    for (const auto& [name, ms] : kernel_times.milliseconds) {
        double sum = 0.0;
        for (const double x : ms) sum += x;
        rows.emplace_back(sum / n_steps,
                          fmt::format("{:<24} {:4} launches", name, ms.size() / std::size_t(n_steps)));
    }
    std::sort(rows.rbegin(), rows.rend());
    for (const auto& [ms, text] : rows) fmt::print("    {:9.2f} ms  {}\n", ms, text);
}

void benchmark_drop_network(const DeviceOptions& device_options, const RayDropNetworkOptions& options,
                            int rows, int columns, int n_repeats) {
    // Opens a new device for each image size, so that the peak of the device memory
    // belongs to this size only.
    Device device(apply_environment_variables(device_options));
    RayDropNetworkBenchmark network(device, options, rows, columns);
    // Measured during training.
    const double step = measure_median_time_ms(n_repeats, [&] { network.run_training_step(); }),
                 peak_mib = double(device.peak_allocated_bytes()) / 0x1p20;
    const double infer = measure_median_time_ms(n_repeats, [&] { network.run_inference(); }),
                 giga = 1e-6 * network.count_inference_flops();
    fmt::print("{:>8} x {:<6} {:10.2f} {:14.1f} {:10.2f} {:14.1f} {:10.1f}\n", rows, columns, step,
               3.0 * options.batch * giga / step, infer, giga / infer, peak_mib);
    print_kernel_times(network.times(), n_repeats + 1);
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app(
        "measures the ray-drop network: wall times of a training step and of an inference (medians, in "
        "milliseconds), and peak memory");
    int repeat = 5, index = -1, rows = 0, columns = 0;
    RayDropNetworkOptions options{.batch = 1};
    app.add_option("--network", options.network, "small, paper or pixel");
    app.add_option("--width", options.width,
                   "number of channels at full resolution; 0: the default of the network");
    app.add_option("--batch", options.batch, "number of images per training step")
        ->check(CLI::Range(1, 1024));
    app.add_option("--rows", rows, "rows of the image (default: measures 66 x 1030 and 64 x 2650)");
    app.add_option("--columns", columns)->needs("--rows");
    app.add_option("--repeat", repeat, "number of repetitions")->check(CLI::Range(1, 10000));
    app.add_option("--device", index, "number of the device in `relidar list devices`");
    CLI11_PARSE(app, argc, argv);
    try {
        DeviceOptions chosen;
        chosen.index = index;
        fmt::print("{}; network {}, {} parameters, batch {}, medians of {} runs\n",
                   Device(apply_environment_variables(chosen)).info().name, options.network,
                   count_network_parameters(options), options.batch, repeat);
        fmt::print("{:<17} {:>10} {:>14} {:>10} {:>14} {:>10}\n", "image", "step ms", "GFLOP/s", "infer ms",
                   "GFLOP/s", "peak MiB");
        std::vector<std::pair<int, int>> sizes{{66, 1030}, {64, 2650}};
        if (rows > 0) sizes = {{rows, columns}};
        for (const auto& [of_rows, of_columns] : sizes)
            benchmark_drop_network(chosen, options, of_rows, of_columns, repeat);
    } catch (const std::exception& error) {
        fmt::print(stderr, "relidar_bench_drop_network: {}\n", error.what());
        return 1;
    }
    return 0;
}
