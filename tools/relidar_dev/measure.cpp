// SPDX-License-Identifier: Apache-2.0
#include "measure.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <random>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/run/stage_options.hpp>
#include "bench/training_step.hpp"
#include "console.hpp"
#include "dev_case.hpp"
#include "diff/forward/count_visits.hpp"
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

using Clock = std::chrono::steady_clock;
using Samples = std::map<std::string, std::vector<double>>;

/// Returns the warm-up time of a device. It is needed because the first launches compile
/// kernels, and because a GPU raises its clock rate only under load.
double measure_warm_up_ms(const Device& device) { return device.info().type == "CPU" ? 200.0 : 2000.0; }

constexpr const char* kOrder[] = {"scene/activate",
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

/// Returns the row of the result table in which a kernel is counted. Groups the kernels
/// that build the tree, prefix sums, and sorts.
std::string get_kernel_row(const std::string& kernel, const std::string& phase) {
    if (kernel == "diff/accel/bvh_top") return "accel/top_level";
    if (kernel.starts_with("diff/accel/bvh_")) return phase == "rebuild" ? "accel/build" : "accel/refit";
    if (kernel.starts_with("gpu/")) return phase == "rebuild" ? "accel/build" : "backward/sort";
    return kernel;
}

RendererOptions make_renderer_options(const DevCase& bench) {
    return {.accel = make_accel_options(bench),
            .trace = make_case_trace_options(bench),
            .n_rays = static_cast<std::uint32_t>(bench.rays.size())};
}

RendererOptions make_training_options(const DevCase& bench, std::uint32_t keep_hits) {
    RendererOptions options = make_renderer_options(bench);
    options.trace = make_training_trace_options(bench.config);
    options.trace.walk = bench.walk;
    options.trace.order = bench.order;
    options.keep_hits = keep_hits;
    return options;
}

/// Returns how many hits per ray would be stored at the end of a training. Training
/// increases this number until only few rays have more hits.
std::uint32_t choose_hits_to_keep(const DevCase& bench, const std::vector<std::uint32_t>& hits) {
    auto keep = static_cast<std::uint32_t>(bench.config.trace.keep_hits);
    while (bench.keeps_more_hits) {
        const auto n_overfull =
            std::count_if(hits.begin(), hits.end(), [&](std::uint32_t count) { return count > keep; });
        const std::uint32_t more = recommend_kept_hits(keep, static_cast<std::uint64_t>(n_overfull));
        if (more == keep) break;
        keep = more;
    }
    return keep;
}

/// Measures the memory of each part of a benchmark, by creating each part once.
BenchMemory measure_memory_of_parts(Device& device, const DevCase& bench, bool training) {
    auto since_last = [&device, last = device.allocated_bytes()]() mutable {
        return device.allocated_bytes() - std::exchange(last, device.allocated_bytes());
    };
    BenchMemory memory;
    const DeviceScene scene(device, bench.scene);
    memory.scene = since_last();
    const Accel accel(device, scene, make_accel_options(bench));
    memory.accel = since_last();
    if (!training) return memory;
    const Gradients gradients(device, scene);
    const Adam adam(device, scene.size(), {}, scene.parameters().parameters());
    memory.training = since_last();
    return memory;
}

class Bench {
public:
    Bench(Device& device, const DevCase& bench)
        : device_(device),
          case_(bench),
          allocated_before_(device.allocated_bytes()),
          rays_(device, std::span<const DeviceRay>(to_device_rays(bench.rays)), "rays") {}

    /// Renders an image to count its hits. To measure training, also creates the training
    /// step and its target values.
    void prepare(bool training) {
        memory_ = measure_memory_of_parts(device_, case_, training);
        image_ = std::make_unique<Renderer>(device_, case_.scene, case_.config.image,
                                            make_renderer_options(case_));
        image_->place(case_.placed, case_.view_origin_m);
        image_->record_forward(batch());
        image_->stream().finish();
        const Rendering rendering = to_rendering(image_->rendered().rendered->download());
        const std::uint32_t keep = training ? choose_hits_to_keep(case_, rendering.hits) : 0,
                            chunk = static_cast<std::uint32_t>(case_.config.trace.chunk);
        for (const std::uint32_t hits : rendering.hits) {
            sizes_.n_hits += hits;
            sizes_.n_hits_written += std::min(hits, keep);
            sizes_.n_hits_kept += hits <= keep ? hits : keep / chunk * chunk;
        }
        if (!training) return;
        image_.reset();
        training_ =
            std::make_unique<TrainingStep>(device_, case_, make_training_options(case_, keep),
                                           make_noisy_targets(rendering, case_.config.loss.normalised_depth));
    }

    /// Runs one repetition: rebuilds the acceleration structure, runs a training
    /// iteration, and moves an instance away and back.
    void repeat() {
        Renderer& r = renderer();
        Stream& stream = r.stream();
        r.accel().update(stream, r.scene(), true);
        stream.finish();
        take("rebuild", rebuild_kernels_);
        const Clock::time_point start = Clock::now();
        r.place(case_.placed, case_.view_origin_m);
        r.record_forward(batch());
        if (training_) {
            training_->compare(batch());
            training_->differentiable.record_backward();
            training_->optimise();
        }
        stream.finish();
        phases_["iteration_wall"].push_back(measure_ms_since(start));
        take("iteration", kernels_);
        const std::vector<InstancePose> before = r.scene().poses();
        std::vector<InstancePose> moved = before;
        moved.back().world_from_model.translation.x += 1.0;
        r.scene().place(stream, moved);
        r.accel().move(stream, r.scene());
        stream.finish();
        take("move", rebuild_kernels_);
        r.scene().place(stream, before);  // The new pose takes effect in the next iteration.
    }

    /// Measures only the forward pass by wall time. Used for devices without timestamps.
    void repeat_by_wall_clock() {
        Renderer& r = renderer();
        r.place(case_.placed, case_.view_origin_m);
        r.stream().finish();
        const Clock::time_point start = Clock::now();
        r.record_forward(batch());
        r.stream().finish();
        kernels_["diff/forward/trace"].push_back(measure_ms_since(start));
    }

    void clear_times() {
        renderer().stream().reset_times();
        for (Samples* samples : {&kernels_, &rebuild_kernels_, &phases_}) samples->clear();
    }

    BenchResult result();
    FloorSizes sizes(const BenchResult& result);

private:
    Device& device_;
    const DevCase& case_;
    std::uint64_t allocated_before_;
    Array<DeviceRay> rays_;
    BenchMemory memory_;  ///< Device memory that each part of the case uses.
    /// Renderer without training. Null if training is measured, because then `training_`
    /// is used.
    std::unique_ptr<Renderer> image_;
    std::unique_ptr<TrainingStep> training_;
    FloorSizes sizes_;
    Samples kernels_, rebuild_kernels_, phases_;

    Renderer& renderer() { return training_ ? training_->renderer : *image_; }
    RayBatch batch() const {
        return {&rays_,
                0,
                1,
                static_cast<std::uint32_t>(rays_.size()),
                static_cast<std::uint32_t>(case_.columns),
                training_ ? &training_->targets : nullptr};
    }

    /// Adds the kernel times since the last call to the samples of a phase.
    void take(const std::string& phase, Samples& kernels) {
        double total = 0.0;
        std::map<std::string, double> sums;
        Stream& stream = renderer().stream();
        for (const auto& [kernel, times] : stream.times().milliseconds)
            sums[get_kernel_row(kernel, phase)] += std::accumulate(times.begin(), times.end(), 0.0);
        for (const auto& [row, ms] : sums) {
            kernels[row].push_back(ms);
            total += ms;
        }
        phases_[phase].push_back(total);
        stream.reset_times();
    }
};

std::vector<BenchRow> make_bench_rows(const Samples& samples, std::vector<std::string> order) {
    for (const auto& [name, unused] : samples) {
        if (std::find(order.begin(), order.end(), name) == order.end()) order.push_back(name);
    }
    std::vector<BenchRow> rows;
    for (const std::string& name : order) {
        if (const auto it = samples.find(name); it != samples.end())
            rows.push_back({name, find_spread(it->second)});
    }
    return rows;
}

BenchResult Bench::result() {
    Renderer& r = renderer();
    if (const std::uint32_t capped = r.forward_pass().pass_cap_count().download()[0])
        throw DeviceError(
            fmt::format("tracing {} rays: {} reached the cap of passes or filled the traversal stack, "
                        "expected every ray to end",
                        rays_.size(), capped));
    // Adds the kernels that do not run in an iteration, such as the build of the
    // acceleration structure.
    kernels_.merge(rebuild_kernels_);
    BenchResult result;
    result.proxy = r.accel().proxy() == Proxy::boxes ? "boxes" : "triangles";
    result.kernels = make_bench_rows(kernels_, {std::begin(kOrder), std::end(kOrder)});
    result.phases = make_bench_rows(phases_, {"rebuild", "iteration", "iteration_wall", "move"});
    const double krays = static_cast<double>(rays_.size()) / 1000.0;
    double forward_ms = 0.0;
    for (const BenchRow& row : result.kernels) {
        if (row.name.starts_with("diff/forward/")) forward_ms += row.ms.median;
        if (row.name == "diff/backward/trace") result.backward_mrays_per_s = krays / row.ms.median;
    }
    result.forward_mrays_per_s = krays / forward_ms;
    result.hits_per_ray = sizes_.n_hits / static_cast<double>(rays_.size());
    result.kept_hits = r.kept_hits();
    result.memory = memory_;
    result.memory.rays =
        device_.allocated_bytes() - allocated_before_ - memory_.scene - memory_.accel - memory_.training;
    result.memory.peak = device_.peak_bytes();
    if (const auto visits = count_visits(device_, r.scene(), r.accel(), batch(), case_.config.image,
                                         make_case_trace_options(case_)))
        result.visits = BenchVisits{visits->nodes, visits->surfels};
    result.sizes = sizes(result);
    return result;
}

/// Returns the sizes of this benchmark, from which lower bounds of the kernel times are
/// computed.
FloorSizes Bench::sizes(const BenchResult& result) {
    FloorSizes s = sizes_;
    s.n_surfels = renderer().scene().size();
    s.n_models = static_cast<double>(case_.scene.models.size());
    s.n_rays = static_cast<double>(rays_.size());
    s.n_sh = (case_.config.image.sh_degree + 1) * (case_.config.image.sh_degree + 1);
    s.sh_per_surfel = case_.config.image.sh_direction == ShDirection::surfel;
    s.training = training_ != nullptr;
    s.lists = kernels_.contains("diff/forward/append");
    s.gather = kernels_.contains("diff/backward/gather");
    s.only_touched = case_.config.train.only_touched;
    s.boxes = renderer().accel().proxy() == Proxy::boxes;
    s.software = device_.traversal() == Traversal::software;
    if (result.visits) {
        s.nodes_opened = result.visits->nodes * s.n_rays;
        s.surfels_tested = result.visits->surfels * s.n_rays;
    }
    if (training_)
        for (const std::uint32_t touched :
             training_->differentiable.gradients().touched.download(renderer().scene().size()))
            s.n_touched += touched;
    return s;
}

}  // namespace

double measure_ms_since(Clock::time_point start) {
    return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

Spread find_spread(std::vector<double> samples) {
    std::sort(samples.begin(), samples.end());
    const auto at = [&](double share) {
        const double place = share * static_cast<double>(samples.size() - 1);
        const auto low = static_cast<std::size_t>(place), high = std::min(low + 1, samples.size() - 1);
        return std::lerp(samples[low], samples[high], place - static_cast<double>(low));
    };
    return {at(0.1), at(0.5), at(0.9)};
}

BenchResult measure(Device& device, const DevCase& bench_case, const BenchSettings& settings) {
    const bool device_clock = device.info().timestamps;
    Progress(settings.quiet).show("warming up");
    Bench bench(device, bench_case);
    const auto repeat = [&] { device_clock ? bench.repeat() : bench.repeat_by_wall_clock(); };
    bench.prepare(settings.backward && device_clock);
    const Clock::time_point start = Clock::now();
    do {
        stop_if_interrupted();
        repeat();
    } while (measure_ms_since(start) < measure_warm_up_ms(device));
    bench.clear_times();
    Progress progress(settings.quiet);
    for (int i = 0; i < settings.repeat; ++i) {
        stop_if_interrupted();
        repeat();
        progress.count("repetition", static_cast<std::size_t>(i) + 1,
                       static_cast<std::size_t>(settings.repeat));
    }
    BenchResult result = bench.result();
    result.device_clock = device_clock;
    return result;
}

}  // namespace relidar::cli
