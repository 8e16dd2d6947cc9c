// SPDX-License-Identifier: Apache-2.0
// relidar_bench_layers measures 3x3 convolutions of the ray-drop network on the device
// and compares them with oneDNN on the host. It measures the forward pass and the
// derivatives by the input and by the weights. Both libraries run alternately in one
// process. The inputs of oneDNN already have its memory layout, and padding columns that
// close the image to a ring. Prints wall times and processor times, which do not include
// GPU time. Set OMP_WAIT_POLICY=passive, so that waiting threads of oneDNN use no
// processor time.
#include <onednn_primitive.hpp>

#include <cmath>
#include <ctime>
#include <functional>
#include <string>
#include <unordered_map>
#include <vector>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include "diff/network/measured_network.hpp"

#include "timing.hpp"

namespace {

using namespace relidar;
using dnnl::algorithm, dnnl::memory;

/// Runs the same convolution with oneDNN on the host.
class HostConvolution {
public:
    explicit HostConvolution(const ConvolutionSize& size)
        : of_from_(make_any_layout_descriptor({1, size.n_in, size.rows, size.columns + 2})),
          of_to_(make_any_layout_descriptor({1, size.n_out, size.rows, size.columns})),
          of_weights_(make_any_layout_descriptor({size.n_out, size.n_in, 3, 3})) {
        const memory::dims strides{1, 1}, ends{1, 0};
        const auto forward = onednn::describe<dnnl::convolution_forward>(
            engine_, dnnl::prop_kind::forward_training, algorithm::convolution_direct, of_from_, of_weights_,
            of_to_, strides, ends, ends);
        const auto by_input = onednn::describe_backward<dnnl::convolution_backward_data>(
            engine_, forward, algorithm::convolution_direct, of_from_, of_weights_, of_to_, strides, ends,
            ends);
        const auto by_weights = onednn::describe_backward<dnnl::convolution_backward_weights>(
            engine_, forward, algorithm::convolution_direct, of_from_, of_weights_, of_to_, strides, ends,
            ends);
        passes_ = {{dnnl::convolution_forward(forward),
                    {{DNNL_ARG_SRC, make_filled_tensor(forward.src_desc())},
                     {DNNL_ARG_WEIGHTS, make_filled_tensor(forward.weights_desc())},
                     {DNNL_ARG_DST, make_filled_tensor(forward.dst_desc())}}},
                   {dnnl::convolution_backward_data(by_input),
                    {{DNNL_ARG_DIFF_DST, make_filled_tensor(by_input.diff_dst_desc())},
                     {DNNL_ARG_WEIGHTS, make_filled_tensor(by_input.weights_desc())},
                     {DNNL_ARG_DIFF_SRC, make_filled_tensor(by_input.diff_src_desc())}}},
                   {dnnl::convolution_backward_weights(by_weights),
                    {{DNNL_ARG_SRC, make_filled_tensor(by_weights.src_desc())},
                     {DNNL_ARG_DIFF_DST, make_filled_tensor(by_weights.diff_dst_desc())},
                     {DNNL_ARG_DIFF_WEIGHTS, make_filled_tensor(by_weights.diff_weights_desc())}}}};
    }

    /// Runs one pass of the convolution.
    /// @param pass_index 0: forward, 1: derivative by the input, 2: derivative by the
    /// weights
    void run_forward_or_gradient_pass(std::size_t pass_index) {
        passes_[pass_index].primitive.execute(stream_, passes_[pass_index].arguments);
        stream_.wait();
    }

private:
    struct OnednnPass {
        dnnl::primitive primitive;
        std::unordered_map<int, memory> arguments;
    };
    dnnl::engine engine_{dnnl::engine::kind::cpu, 0};
    dnnl::stream stream_{engine_};
    memory::desc of_from_, of_to_, of_weights_;
    std::vector<OnednnPass> passes_;

    static memory::desc make_any_layout_descriptor(const memory::dims& dimensions) {
        return {dimensions, memory::data_type::f32, memory::format_tag::any};
    }
    memory make_filled_tensor(const memory::desc& descriptor) {
        memory result(descriptor, engine_);
        auto* values = static_cast<float*>(result.get_data_handle());
        for (std::size_t i = 0; i < descriptor.get_size() / sizeof(float); ++i)
            values[i] = float(i % 257) / 128.0f - 1.0f;
        return result;
    }
};

/// Times of the repetitions in milliseconds.
struct WallAndCpuTimes {
    std::vector<double> wall, cpu;

    void time_pass_and_append(const std::function<void()>& run_pass) {
        const std::clock_t start = std::clock();
        wall.push_back(measure_wall_time_ms(run_pass));
        cpu.push_back(1e3 * double(std::clock() - start) / CLOCKS_PER_SEC);
    }
};

/// Prints one line with wall times, processor times and GFLOP per second, for the device
/// and for oneDNN.
void print_gpu_and_cpu_pass_times(const ConvolutionSize& size, const char* pass_name,
                                  const WallAndCpuTimes& gpu_times, const WallAndCpuTimes& cpu_times) {
    const double of_device = median(gpu_times.cpu), of_host = median(cpu_times.cpu),
                 wall_device = median(gpu_times.wall), wall_host = median(cpu_times.wall),
                 operations = 1e-6 * size.count_convolution_flops();
    fmt::print(
        "{:>7} {:>7} {:<10} {:9.2f} {:9.2f} {:9.2f} {:9.2f} {:9.1f} {:9.1f} {:9.1f} {:9.1f} {:7.2f} "
        "{:7.2f}\n",
        fmt::format("{}x{}", size.rows, size.columns), fmt::format("{}->{}", size.n_in, size.n_out),
        pass_name, wall_device, wall_host, of_device, of_host, operations / wall_device,
        operations / wall_host, operations / of_device, operations / of_host, wall_device / wall_host,
        of_device / of_host);
}

void benchmark_convolution(Device& device, const ConvolutionSize& size, int n_repeats) {
    ConvolutionBenchmark on_device(device, size);
    HostConvolution on_host(size);
    const std::vector<std::pair<const char*, std::function<void()>>> passes{
        {"forward", [&] { on_device.run_forward_pass(); }},
        {"by input", [&] { on_device.compute_input_gradient(); }},
        {"by weights", [&] { on_device.compute_weight_gradient(); }}};
    for (std::size_t pass = 0; pass < passes.size(); ++pass) {
        const auto host = [&] { on_host.run_forward_or_gradient_pass(pass); };
        passes[pass].second();
        host();  // Warm-up run, not timed.
        WallAndCpuTimes of_device, of_host;
        for (int i = 0; i < n_repeats; ++i) {
            of_device.time_pass_and_append(passes[pass].second);
            of_host.time_pass_and_append(host);
        }
        print_gpu_and_cpu_pass_times(size, passes[pass].first, of_device, of_host);
    }
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app(
        "compares the 3x3 convolutions of the ray-drop network on the device with oneDNN on the host: median "
        "times and their ratio");
    int repeat = 15, index = -1;
    app.add_option("--repeat", repeat, "number of repetitions")->check(CLI::Range(1, 10000));
    app.add_option("--device", index, "number of the device in `relidar list devices`");
    CLI11_PARSE(app, argc, argv);
    try {
        DeviceOptions options;
        options.index = index;
        Device device(apply_environment_variables(options));
        const dnnl_version_t* version = dnnl_version();
        fmt::print(
            "{}; oneDNN {}.{}.{}; medians of {} alternating repetitions; ratio: device / oneDNN, of wall "
            "times and of "
            "processor times\n",
            device.info().name, version->major, version->minor, version->patch, repeat);
        fmt::print("{:>7} {:>7} {:<10} {:>19} {:>19} {:>19} {:>19} {:>15}\n", "image", "layers", "pass",
                   "wall ms", "processor ms", "GFLOP/s (wall)", "GFLOP/s per core", "ratio");
        for (const ConvolutionSize& size :
             {ConvolutionSize{64, 2000, 16, 16}, ConvolutionSize{64, 2650, 32, 32},
              ConvolutionSize{33, 515, 64, 64}})
            benchmark_convolution(device, size, repeat);
    } catch (const std::exception& error) {
        fmt::print(stderr, "relidar_bench_layers: {}\n", error.what());
        return 1;
    }
    return 0;
}
