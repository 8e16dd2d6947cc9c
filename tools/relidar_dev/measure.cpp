// SPDX-License-Identifier: Apache-2.0
#include "measure.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <utility>

#include <relidar/base/error.hpp>
#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/run/stage_options.hpp>
#include "base/fail.hpp"
#include "bench/training_step.hpp"
#include "console.hpp"
#include "dev_case.hpp"
#include "diff/forward/count_visits.hpp"
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

using TimesByKernel = std::map<std::string, std::vector<double>>;

constexpr const char* kRowOrder[] = {"scene/activate",
                                     "diff/accel/proxies",
                                     "accel/build",
                                     "accel/refit",
                                     "accel/top_level",
                                     "diff/forward/append",
                                     "diff/forward/sort_hits",
                                     "diff/forward/blend",
                                     "diff/forward/trace",
                                     "diff/loss/image_loss",
                                     "fill",
                                     "backward/sort",
                                     "diff/backward/trace",
                                     "diff/backward/gather",
                                     "diff/backward/gather_heads",
                                     "scene/activate_vjp",
                                     "diff/optimizer/adam"};

/// Returns the row of the result table to which a kernel's time is added. Several
/// kernels, for example all kernels that build the BVH, share a row.
std::string row_name(const std::string& kernel_name, const std::string& phase_name) {
    if (kernel_name == "diff/accel/bvh_top") return "accel/top_level";
    if (kernel_name.starts_with("diff/accel/bvh_"))
        return phase_name == "rebuild" ? "accel/build" : "accel/refit";
    // Kernels in gpu/, such as the sort, serve the build or the backward pass.
    if (kernel_name.starts_with("gpu/")) return phase_name == "rebuild" ? "accel/build" : "backward/sort";
    return kernel_name;
}

RendererOptions forward_options(const DevCase& setup) {
    return {.accel = {.proxy = setup.proxy},
            .trace = trace_options(setup),
            .n_rays = std::uint32_t(setup.rays.size())};
}

/// Returns how many hits per ray would be stored at the end of a training. Training
/// increases this number until only few rays have more hits.
/// @param hits_of_ray number of blended hits of each ray
std::uint32_t predict_hits(const DevCase& setup, const std::vector<std::uint32_t>& hits_of_ray) {
    auto n_stored = std::uint32_t(setup.config.trace.keep_hits);
    while (setup.keeps_more_hits) {
        const auto n_overfull_rays =
            std::ranges::count_if(hits_of_ray, [&](std::uint32_t n_hits) { return n_hits > n_stored; });
        const std::uint32_t n_grown = grow_stored_hits(n_stored, std::uint64_t(n_overfull_rays));
        if (n_grown == n_stored) break;
        n_stored = n_grown;
    }
    return n_stored;
}

/// Measures the device memory of each part of a benchmark, by creating each part once.
BenchMemory measure_memory(Device& device, const DevCase& setup, bool includes_training) {
    // Returns the bytes that were allocated since its last call.
    auto new_bytes = [&device, before = device.allocated_bytes()]() mutable {
        return device.allocated_bytes() - std::exchange(before, device.allocated_bytes());
    };
    BenchMemory memory;
    const DeviceScene scene(device, setup.scene);
    memory.scene = new_bytes();
    const AccelerationStructure accel(device, scene, {.proxy = setup.proxy});
    memory.accel = new_bytes();
    if (!includes_training) return memory;
    const DeviceGradients gradients(device, scene);
    const Adam adam(device, scene.size(), {}, scene.surfel_parameters().parameters_used());
    memory.training = new_bytes();
    return memory;
}

class BenchRunner {
public:
    BenchRunner(Device& device, const DevCase& setup)
        : device_(device),
          case_(setup),
          allocated_before_(device.allocated_bytes()),
          rays_(device, to_device_rays(setup.rays), "rays") {}

    /// Renders an image to count its hits. If `includes_training` is true, also creates
    /// the training step and its target values.
    void create_renderers(bool includes_training) {
        memory_ = measure_memory(device_, case_, includes_training);
        image_ = std::make_unique<Renderer>(device_, case_.scene, case_.config.image, forward_options(case_));
        image_->update(case_.placed, case_.view_origin_m);
        image_->record_forward(make_ray_batch());
        image_->stream().submit_and_wait();
        const RenderedRayValues rendering = to_ray_values(image_->last_batch().rendered->download());
        const std::uint32_t n_stored = includes_training ? predict_hits(case_, rendering.hits) : 0,
                            chunk = std::uint32_t(case_.config.trace.chunk);
        // If a ray has more hits than are stored, the backward pass reads only full
        // chunks of them and searches the other hits again.
        for (const std::uint32_t n_hits : rendering.hits) {
            sizes_.n_hits += n_hits;
            sizes_.n_hits_written += std::min(n_hits, n_stored);
            sizes_.n_stored_hits_read += n_hits <= n_stored ? n_hits : n_stored / chunk * chunk;
        }
        if (!includes_training) return;
        image_.reset();
        RendererOptions options = forward_options(case_);
        options.trace = training_options(case_.config);
        options.trace.traversal_mode = case_.traversal_mode;
        options.trace.order = case_.order;
        options.keep_hits = n_stored;
        training_ = std::make_unique<TrainingStep>(
            device_, case_, options, noisy_targets(rendering, case_.config.loss.normalised_depth));
    }

    /// Runs one repetition: rebuilds the acceleration structure, runs a training
    /// iteration, and moves an instance away and back.
    void run_repetition() {
        Renderer& renderer = get_renderer();
        Stream& stream = renderer.stream();
        renderer.accel().record_refit(stream, renderer.scene(), true);
        stream.submit_and_wait();
        append_times("rebuild", rebuild_kernels_);
        const Clock::time_point start = Clock::now();
        renderer.update(case_.placed, case_.view_origin_m);
        renderer.record_forward(make_ray_batch());
        if (training_) {
            training_->record_losses(make_ray_batch());
            training_->differentiable.record_backward();
            training_->record_optimizer();
        }
        stream.submit_and_wait();
        phases_["iteration_wall"].push_back(ms_since(start));
        append_times("iteration", kernels_);
        const std::vector<InstancePose> old_poses = renderer.scene().poses();
        std::vector<InstancePose> moved_poses = old_poses;
        moved_poses.back().world_from_model.translation.x += 1.0;
        renderer.scene().stage_poses(stream, moved_poses);
        renderer.accel().record_top_level(stream, renderer.scene());
        stream.submit_and_wait();
        append_times("move", rebuild_kernels_);
        renderer.scene().stage_poses(stream, old_poses);  // takes effect in the next iteration
    }

    void clear_samples() {
        get_renderer().stream().reset_times();
        for (TimesByKernel* samples : {&kernels_, &rebuild_kernels_, &phases_}) samples->clear();
    }

    BenchResult bench_result();
    MemoryTrafficSizes traffic_sizes();

private:
    Device& device_;
    const DevCase& case_;
    std::uint64_t allocated_before_;
    Array<DeviceRay> rays_;
    BenchMemory memory_;  ///< Device memory that each part of the case uses.
    /// Renderer in benchmarks of rendering. Null in those of training (`training_`).
    std::unique_ptr<Renderer> image_;
    std::unique_ptr<TrainingStep> training_;
    MemoryTrafficSizes sizes_;
    TimesByKernel kernels_, rebuild_kernels_, phases_;

    Renderer& get_renderer() { return training_ ? training_->renderer : *image_; }
    RayBatch make_ray_batch() const {
        return {&rays_,
                0,
                1,
                std::uint32_t(rays_.size()),
                std::uint32_t(case_.columns),
                training_ ? &training_->targets : nullptr};
    }

    /// Adds the kernel times since the last call to the samples of a phase. The time of a
    /// kernel is the sum of its launches.
    void append_times(const std::string& phase_name, TimesByKernel& kernel_samples) {
        double total = 0.0;
        std::map<std::string, double> sums;
        Stream& stream = get_renderer().stream();
        for (const auto& [kernel, times] : stream.times().milliseconds)
            sums[row_name(kernel, phase_name)] += std::accumulate(times.begin(), times.end(), 0.0);
        for (const auto& [row, ms] : sums) {
            kernel_samples[row].push_back(ms);
            total += ms;
        }
        phases_[phase_name].push_back(total);
        stream.reset_times();
    }
};

/// Returns percentiles of all samples. Names in `order` are first, other names follow.
std::vector<KernelBenchTime> percentile_rows(const TimesByKernel& samples, std::vector<std::string> order) {
    for (const auto& [name, unused] : samples) {
        if (std::find(order.begin(), order.end(), name) == order.end()) order.push_back(name);
    }
    std::vector<KernelBenchTime> rows;
    for (const std::string& name : order) {
        if (const auto it = samples.find(name); it != samples.end())
            rows.push_back({name, percentiles_of(it->second)});
    }
    return rows;
}

/// Checks that all rays were traced completely, because the times would be wrong.
void check_complete_rays(const Renderer& renderer, std::size_t n_rays) {
    const std::uint32_t n_truncated = renderer.forward_pass().n_truncated_rays().download()[0];
    if (n_truncated > 0)
        fail<DeviceError>(
            "cannot trace {} rays: {} of them reached the maximum number of passes or filled the traversal "
            "stack, expected none",
            n_rays, n_truncated);
}

/// Computes the rates of both passes from the median times of their kernels.
void set_ray_rates(BenchResult& result, std::size_t n_rays) {
    const double krays = double(n_rays) / 1000.0;  // krays / ms = Mrays / s
    double forward_ms = 0.0;
    for (const KernelBenchTime& row : result.kernels) {
        if (row.name.starts_with("diff/forward/")) forward_ms += row.ms.median;
        if (row.name == "diff/backward/trace") result.backward_mrays_per_s = krays / row.ms.median;
    }
    result.forward_mrays_per_s = krays / forward_ms;
}

/// Returns the results of all repetitions: percentiles of all times, rates in million
/// rays per second, and memory in bytes.
/// @throws DeviceError if a ray was not traced completely
BenchResult BenchRunner::bench_result() {
    Renderer& renderer = get_renderer();
    check_complete_rays(renderer, rays_.size());
    // merge() adds only kernels that no iteration has run.
    kernels_.merge(rebuild_kernels_);
    BenchResult result;
    result.proxy = renderer.accel().proxy_shape() == ProxyShape::boxes ? "boxes" : "triangles";
    result.kernels = percentile_rows(kernels_, {std::begin(kRowOrder), std::end(kRowOrder)});
    result.phases = percentile_rows(phases_, {"rebuild", "iteration", "iteration_wall", "move"});

    set_ray_rates(result, rays_.size());
    result.hits_per_ray = sizes_.n_hits / double(rays_.size());
    result.stored_hits_per_ray = renderer.stored_hits_per_ray();

    result.memory = memory_;
    const auto benchmark_bytes = device_.allocated_bytes() - allocated_before_;
    result.memory.rays = benchmark_bytes - surfel_bytes(memory_);  // all but the surfels
    result.memory.peak = device_.peak_bytes();
    if (const auto visits = count_visits(device_, renderer.scene(), renderer.accel(), make_ray_batch(),
                                         case_.config.image, trace_options(case_)))
        result.visits = BenchVisits{visits->nodes, visits->surfels};
    result.sizes = traffic_sizes();
    return result;
}

/// Returns the sizes from which the minimum memory traffic of the kernels is computed.
MemoryTrafficSizes BenchRunner::traffic_sizes() {
    MemoryTrafficSizes sizes = sizes_;
    sizes.n_surfels = get_renderer().scene().size();
    sizes.n_models = double(case_.scene.models.size());
    sizes.n_rays = double(rays_.size());
    // Spherical harmonics up to degree d have (d + 1)^2 coefficients.
    sizes.n_sh = (case_.config.image.sh_degree + 1) * (case_.config.image.sh_degree + 1);
    sizes.sh_per_surfel = case_.config.image.sh_direction == ShDirection::surfel;
    sizes.training = training_ != nullptr;
    // The names of the measured kernels show which methods the renderer has chosen.
    sizes.lists = kernels_.contains("diff/forward/append");
    sizes.gather = kernels_.contains("diff/backward/gather");
    sizes.only_touched = case_.config.train.only_touched;
    sizes.boxes = get_renderer().accel().proxy_shape() == ProxyShape::boxes;
    sizes.software = device_.backend() == RayTracingBackend::software;
    if (training_) {
        // [n_surfels] 1 if any ray has hit the surfel, otherwise 0
        const std::vector<std::uint32_t> touched =
            training_->differentiable.gradients().touched.download(get_renderer().scene().size());
        sizes.n_touched = double(std::ranges::count(touched, 1u));
    }
    return sizes;
}

}  // namespace

TimePercentiles percentiles_of(std::vector<double> samples) {
    std::sort(samples.begin(), samples.end());
    const auto at = [&](double share) {
        const double sample_position = share * double(samples.size() - 1);
        const auto low = std::size_t(sample_position), high = std::min(low + 1, samples.size() - 1);
        return std::lerp(samples[low], samples[high], sample_position - double(low));
    };
    return {at(0.1), at(0.5), at(0.9)};
}

BenchResult run_benchmark(Device& device, const DevCase& setup, const BenchSettings& settings) {
    if (!device.info().timestamps)
        throw DeviceError(
            "cannot measure kernels: this GPU driver does not support timestamps; use `relidar check "
            "--speed`");
    TerminalProgress(settings.quiet).show_text("running repetitions that are not measured");
    BenchRunner bench(device, setup);
    bench.create_renderers(settings.backward);
    // Warms up, because the first launches compile kernels, and because a GPU raises its
    // clock rate only under load.
    const double warm_up_ms = device.info().type == "CPU" ? 200.0 : 2000.0;
    const Clock::time_point start = Clock::now();
    do {
        check_interrupt();
        bench.run_repetition();
    } while (ms_since(start) < warm_up_ms);
    bench.clear_samples();
    TerminalProgress progress(settings.quiet);
    for (int i = 0; i < settings.repeat; ++i) {
        check_interrupt();
        bench.run_repetition();
        progress.show_step("repetition", std::size_t(i) + 1, std::size_t(settings.repeat));
    }
    return bench.bench_result();
}

}  // namespace relidar::cli
