// SPDX-License-Identifier: Apache-2.0
#include "bench_measure.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>
#include <random>

#include <fmt/format.h>

#include "bench_case.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include <relidar/stages/backward.hpp>
#include <relidar/error.hpp>
#include <relidar/measure/forward.hpp>
#include <relidar/stages/forward.hpp>

namespace relidar::cli {
namespace {

using Clock = std::chrono::steady_clock;
using Samples = std::map<std::string, std::vector<double>>;

constexpr double kWarmUp_ms = 200.0;   // kernels are compiled and clocks raised in the first moments
constexpr const char* kOrder[] = {"scene/activate", "accel/proxies", "accel/build", "accel/refit", "accel/top_level", "forward/trace",
                                  "loss/image_loss", "fill", "backward/sort", "backward/trace", "backward/gather", "backward/gather_heads", "scene/activate_vjp", "optimizer/adam"};

double ms_since(Clock::time_point start) { return std::chrono::duration<double, std::milli>(Clock::now() - start).count(); }

/// Row that a kernel counts in. Those of the software tree go together, under the names of the driver's builds; so do prefix sums and sorts.
std::string row_of(const std::string& kernel, const std::string& phase) {
    if (kernel == "accel/bvh_top") return "accel/top_level";
    if (kernel.starts_with("accel/bvh_")) return phase == "rebuild" ? "accel/build" : "accel/refit";
    if (kernel.starts_with("gpu/")) return phase == "rebuild" ? "accel/build" : "backward/sort";
    return kernel;
}

/// What was rendered, with uniform noise: no gradient of the L1 terms is zero. Rays that met little are dropped ones.
std::vector<DeviceTarget> noisy_targets(const Rendering& rendering, bool normalised_depth) {
    constexpr float kRangeNoise_m = 0.1f, kIntensityNoise = 0.05f, kSolid = 0.5f;
    std::mt19937 random(1);
    const auto noise = [&] { return static_cast<float>(random()) / 2147483648.0f - 1.0f; };
    std::vector<DeviceTarget> targets(rendering.size(), {.range_m = 0.0f, .intensity = 0.0f, .weight = 1.0f});
    for (std::size_t i = 0; i < targets.size(); ++i) {
        if (!(rendering.weight[i] > kSolid)) continue;
        const float range_m = rendering.depth[i] / (normalised_depth ? rendering.weight[i] : 1.0f);
        targets[i].range_m = std::max(range_m + kRangeNoise_m * noise(), 0.01f);
        targets[i].intensity = rendering.intensity[i] + kIntensityNoise * noise();
    }
    return targets;
}

/// What training has beside a scene and its image.
struct TrainingState {
    Gradients gradients;
    Adam adam;
    std::uint64_t allocated_with_moments;
    ImageLoss loss;
    BackwardPass backward;
    Array<DeviceTarget> targets;
    Array<shared::RayGradient> upstream;
    Array<float> terms;
    KeptHits kept;
    double n_returned = 0.0;
    int step = 0;

    TrainingState(Device& device, const BenchCase& bench, const DeviceScene& scene, Proxy proxy, const std::vector<DeviceTarget>& wanted)
        : gradients(device, scene),
          adam(device, static_cast<std::uint32_t>(bench.scene.surfels.size()), {.only_touched = bench.config.train.only_touched}, scene.primitive()),
          allocated_with_moments(device.allocated_bytes()),
          loss(device, bench.config.loss),
          backward(device, bench.config.image, proxy, trace_options(bench.config), backward_options(bench.config)),
          targets(device, std::span<const DeviceTarget>(wanted), "targets"),
          upstream(device, wanted.size(), "loss gradients"),
          terms(device, std::vector<float>(kLossTerms, 0.0f), "loss terms"),
          kept(device, wanted.size(), static_cast<std::uint32_t>(bench.config.trace.keep_hits)) {
        gradients.zero_untouched = false;   // Adam takes the others for zero
        for (const DeviceTarget& target : wanted) n_returned += target.range_m > 0.0f;
    }
};

class Bench {
public:
    Bench(Device& device, const BenchCase& bench)
        : device_(device),
          case_(bench),
          stream_(device, true),
          allocated_before_(device.allocated_bytes()),
          scene_(device, bench.scene),
          allocated_with_scene_(device.allocated_bytes()),
          accel_(device, scene_, accel_options(bench.config)),
          allocated_with_accel_(device.allocated_bytes()),
          forward_(device, bench.config.image, accel_.proxy(), trace_options(bench.config)),
          rays_(device, std::span<const DeviceRay>(to_device_rays(bench.rays)), "rays"),
          rendered_(device, bench.rays.size(), "rendered rays") {
        scene_.place(stream_, bench.placed);
    }

    /// The first image; with it the targets and all that training needs.
    void prepare(bool training) {
        frame();
        stream_.finish();
        const Rendering rendering = to_rendering(rendered_.download());
        const double keep = training ? case_.config.trace.keep_hits : 0;
        for (const std::uint32_t hits : rendering.hits) {
            sizes_.n_hits += hits;
            sizes_.n_hits_written += std::min<double>(hits, keep);
            sizes_.n_hits_kept += hits <= keep ? hits : 0.0;
        }
        if (!training) return;
        const std::uint64_t before = device_.allocated_bytes();
        training_ = std::make_unique<TrainingState>(device_, case_, scene_, accel_.proxy(), noisy_targets(rendering, case_.config.loss.normalised_depth));
        training_bytes_ = training_->allocated_with_moments - before;
    }

    /// One repetition: rebuild, a whole iteration, an instance moved and put back.
    void repeat() {
        accel_.update(stream_, scene_, true);
        stream_.finish();
        take("rebuild", rebuild_kernels_);
        const Clock::time_point start = Clock::now();
        frame();
        if (training_) learn(*training_);
        stream_.finish();
        phases_["iteration_wall"].push_back(ms_since(start));
        take("iteration", kernels_);
        const std::vector<InstancePose> before = scene_.poses();
        std::vector<InstancePose> moved = before;
        moved.back().world_from_model.translation.x += 1.0;
        scene_.place(stream_, moved);
        accel_.move(stream_, scene_);
        stream_.finish();
        take("move", rebuild_kernels_);
        scene_.place(stream_, before);   // takes effect in the next iteration
    }

    /// Without timestamps: forward alone between two waits.
    void repeat_by_wall_clock() {
        scene_.activate(stream_, case_.config.image, case_.view_origin_m);
        accel_.update(stream_, scene_);
        stream_.finish();
        const Clock::time_point start = Clock::now();
        forward_.run(stream_, scene_, accel_, batch(), rendered_);
        stream_.finish();
        kernels_["forward/trace"].push_back(ms_since(start));
    }

    void forget_times() {
        stream_.reset_times();
        for (Samples* samples : {&kernels_, &rebuild_kernels_, &phases_}) samples->clear();
    }

    BenchResult result();
    FloorSizes sizes(const BenchResult& result) const;

private:
    Device& device_;
    const BenchCase& case_;
    Stream stream_;
    std::uint64_t allocated_before_;
    DeviceScene scene_;
    std::uint64_t allocated_with_scene_;
    Accel accel_;
    std::uint64_t allocated_with_accel_;
    ForwardPass forward_;
    Array<DeviceRay> rays_;
    Array<shared::RenderedRay> rendered_;
    std::unique_ptr<TrainingState> training_;
    std::uint64_t training_bytes_ = 0;
    FloorSizes sizes_;
    Samples kernels_, rebuild_kernels_, phases_;

    RayBatch batch() const { return {&rays_, 0, 1, static_cast<std::uint32_t>(rays_.size()), static_cast<std::uint32_t>(case_.columns)}; }
    void frame() {
        scene_.activate(stream_, case_.config.image, case_.view_origin_m);
        accel_.update(stream_, scene_);
        forward_.run(stream_, scene_, accel_, batch(), rendered_, training_ ? &training_->kept : nullptr);
    }

    void learn(TrainingState& t) {
        constexpr LearningRates kStandStill{0.0, 0.0, 0.0, 0.0, 0.0, 0.05};
        const RayBatch rays = batch();
        t.loss.run(stream_, {&t.targets, 0, 1, rays.n_rays, t.n_returned, static_cast<double>(rays.n_rays)}, rendered_, t.upstream, t.terms);
        t.backward.run(stream_, scene_, accel_, {rays, &rendered_, &t.upstream, &t.kept}, case_.view_origin_m, t.gradients);
        t.adam.step(stream_, scene_.parameters(), t.gradients.surfels, &t.gradients.touched, kStandStill, ++t.step, case_.config.image.sh_degree);
    }

    /// Sums the times since the last call by kernel.
    void take(const std::string& phase, Samples& kernels) {
        double total = 0.0;
        std::map<std::string, double> sums;
        for (const auto& [kernel, times] : stream_.times().milliseconds) sums[row_of(kernel, phase)] += std::accumulate(times.begin(), times.end(), 0.0);
        for (const auto& [row, ms] : sums) {
            kernels[row].push_back(ms);
            total += ms;
        }
        phases_[phase].push_back(total);
        stream_.reset_times();
    }
};

std::vector<BenchRow> rows_of(const Samples& samples, std::vector<std::string> order) {
    for (const auto& [name, unused] : samples) {
        if (std::find(order.begin(), order.end(), name) == order.end()) order.push_back(name);
    }
    std::vector<BenchRow> rows;
    for (const std::string& name : order) {
        if (const auto it = samples.find(name); it != samples.end()) rows.push_back({name, spread_of(it->second)});
    }
    return rows;
}

BenchResult Bench::result() {
    if (const std::uint32_t capped = forward_.take_pass_cap_count()) throw DeviceError(fmt::format("tracing {} rays: {} reached the cap of passes or filled the traversal stack, expected every ray to end", rays_.size(), capped));
    kernels_.merge(rebuild_kernels_);   // those that an iteration has not
    BenchResult result;
    result.proxy = accel_.proxy() == Proxy::boxes ? "boxes" : "triangles";
    result.kernels = rows_of(kernels_, {std::begin(kOrder), std::end(kOrder)});
    result.phases = rows_of(phases_, {"rebuild", "iteration", "iteration_wall", "move"});
    const double krays = static_cast<double>(rays_.size()) / 1000.0;
    for (const BenchRow& row : result.kernels) {
        if (row.name == "forward/trace") result.forward_mrays_per_s = krays / row.ms.median;
        if (row.name == "backward/trace") result.backward_mrays_per_s = krays / row.ms.median;
    }
    result.hits_per_ray = sizes_.n_hits / static_cast<double>(rays_.size());
    if (const auto visits = count_visits(device_, scene_, accel_, batch(), case_.config.image, trace_options(case_.config))) result.visits = BenchVisits{visits->nodes, visits->surfels};
    result.memory = {allocated_with_scene_ - allocated_before_, allocated_with_accel_ - allocated_with_scene_, training_bytes_, device_.allocated_bytes() - allocated_with_accel_ - training_bytes_, device_.peak_bytes()};
    result.sizes = sizes(result);
    return result;
}

/// What the floors of this case follow from.
FloorSizes Bench::sizes(const BenchResult& result) const {
    FloorSizes s = sizes_;
    s.n_surfels = scene_.size();
    s.n_models = static_cast<double>(case_.scene.models.size());
    s.n_rays = static_cast<double>(rays_.size());
    s.n_sh = (case_.config.image.sh_degree + 1) * (case_.config.image.sh_degree + 1);
    s.sh_per_surfel = case_.config.image.sh_direction == ShDirection::surfel;
    s.training = training_ != nullptr;
    s.gather = kernels_.contains("backward/gather");
    s.only_touched = case_.config.train.only_touched;
    s.boxes = accel_.proxy() == Proxy::boxes;
    s.software = device_.traversal() == Traversal::software;
    if (result.visits) {
        s.nodes_opened = result.visits->nodes * s.n_rays;
        s.surfels_tested = result.visits->surfels * s.n_rays;
    }
    if (training_)
        for (const std::uint32_t touched : training_->gradients.touched.download(scene_.size())) s.n_touched += touched;
    return s;
}

}  // namespace

Spread spread_of(std::vector<double> samples) {
    std::sort(samples.begin(), samples.end());
    const auto at = [&](double share) {
        const double place = share * static_cast<double>(samples.size() - 1);
        const auto low = static_cast<std::size_t>(place), high = std::min(low + 1, samples.size() - 1);
        return std::lerp(samples[low], samples[high], place - static_cast<double>(low));
    };
    return {at(0.1), at(0.5), at(0.9)};
}

namespace {

BenchResult measure_case(Device& device, const BenchCase& bench_case, const BenchSettings& settings) {
    const bool device_clock = device.info().timestamps;
    Progress(settings.quiet).show("warming up");
    Bench bench(device, bench_case);
    const auto repeat = [&] { device_clock ? bench.repeat() : bench.repeat_by_wall_clock(); };
    bench.prepare(settings.backward && device_clock);
    const Clock::time_point start = Clock::now();
    do {
        stop_if_interrupted();
        repeat();
    } while (ms_since(start) < kWarmUp_ms);
    bench.forget_times();
    Progress progress(settings.quiet);
    for (int i = 0; i < settings.repeat; ++i) {
        stop_if_interrupted();
        repeat();
        progress.count("repetition", static_cast<std::size_t>(i) + 1, static_cast<std::size_t>(settings.repeat));
    }
    BenchResult result = bench.result();
    result.device_clock = device_clock;
    return result;
}

}  // namespace

BenchResult measure(Device& device, const BenchCase& bench_case, const BenchSettings& settings) {
    BenchResult result = measure_case(device, bench_case, settings);
    result.copy_bytes_per_s = copy_bytes_per_s(device);   // now that the case has left the memory
    return result;
}

}  // namespace relidar::cli
