// SPDX-License-Identifier: Apache-2.0
// The training loop: sample a frame, render its rays, compare, differentiate, step (docs/method.md sections 4-6). One submission
// an iteration; losses are read back at log lines only.
#include <relidar/train.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include <relidar/backward.hpp>
#include <relidar/error.hpp>
#include <relidar/forward.hpp>
#include <relidar/optimizer.hpp>

#include "core/random.hpp"
#include "train/frame_data.hpp"

namespace relidar {

namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// Frames in random order, each once an epoch.
class FrameSampler {
public:
    FrameSampler(std::size_t n, std::uint64_t seed) : order_(n), random_(seed) { std::iota(order_.begin(), order_.end(), std::size_t(0)); }
    std::size_t next() {
        if (position_ == 0)
            for (std::size_t i = order_.size(); i > 1; --i) std::swap(order_[i - 1], order_[random_.next() % i]);
        const std::size_t frame = order_[position_];
        position_ = (position_ + 1) % order_.size();
        return frame;
    }
    Random& random() { return random_; }

private:
    std::vector<std::size_t> order_;
    std::size_t position_ = 0;
    Random random_;
};

LearningRates rates_at(const TrainConfig& c, double extent_m, int step) {
    const double decay = exponential_schedule(1.0, c.rate_decay, step, c.iterations);
    return {exponential_schedule(c.mean_rate, c.mean_rate_final, step, c.iterations) * extent_m, c.rotation_rate * decay, c.scale_rate * decay,
            c.opacity_rate * decay, c.sh_rate * decay, c.sh_rest_factor};
}

ImageModel with_degree(ImageModel model, int degree) {
    model.sh_degree = std::min(model.sh_degree, degree);
    return model;
}

/// Everything one iteration touches on the device.
struct Loop {
    Device& device;
    const Config& config;
    std::vector<FrameData> frames;
    Stream stream;
    DeviceScene scene;
    Accel accel;
    ForwardPass forward;
    ImageLoss loss;
    BackwardPass backward;
    Adam adam;
    Gradients gradients;
    Array<float> rendered, upstream, terms;
    double extent_m;
    FrameSampler sampler;

    Loop(Device& d, const Sequence& sequence, const Split& split, const Scene& initial, const Config& c)
        : device(d),
          config(c),
          frames(upload_frames(d, sequence, split.train, c.init)),
          stream(d, true),
          scene(d, initial),
          accel(d, scene, accel_options(c)),
          forward(d, c.image, accel.proxy(), trace_options(c)),
          loss(d, c.loss),
          backward(d, c.image, accel.proxy(), trace_options(c)),
          adam(d, scene.size(), {.only_touched = c.train.only_touched}),
          gradients(d, scene.size()),
          rendered(d, std::size_t(largest_batch()) * kRenderedFloats, "rendered rays"),
          upstream(d, std::size_t(largest_batch()) * kUpstreamFloats, "loss gradients"),
          terms(d, kLossTerms, "loss terms"),
          extent_m(c.train.extent_m > 0.0 ? c.train.extent_m : background_extent(initial.surfels)),
          sampler(frames.size(), c.train.seed) {}

    std::uint32_t largest_batch() const {
        std::uint32_t largest = 0;
        for (const FrameData& frame : frames) largest = std::max(largest, frame.n_rays);
        return largest;
    }

    /// Records and submits one iteration. @param step counts from 1
    void iterate(int step) {
        const FrameData& frame = frames[sampler.next()];
        const std::uint32_t wanted = config.train.rays_per_iteration > 0 ? static_cast<std::uint32_t>(config.train.rays_per_iteration) : frame.n_rays;
        const std::uint32_t stride = std::max(1u, frame.n_rays / std::max(wanted, 1u));
        const std::uint32_t first = static_cast<std::uint32_t>(sampler.random().next() % stride);
        const RayBatch batch{&frame.rays, first, stride, (frame.n_rays - first + stride - 1) / stride};
        const ImageModel model = with_degree(config.image, (step - 1) / std::max(1, config.train.sh_degree_interval));
        forward.set_sh_degree(model.sh_degree);
        backward.set_sh_degree(model.sh_degree);

        scene.activate(stream, model, frame.sensor_position_m);
        accel.update(stream, scene);
        forward.run(stream, scene, accel, batch, rendered);                                                          // Eq. 2-4
        loss.run(stream, rendered, frame.targets, first, stride, batch.n_rays, frame.n_returned / stride, frame.n_known / stride, upstream, terms);   // Eq. 10
        backward.run(stream, scene, accel, batch, rendered, upstream, frame.sensor_position_m, gradients);           // Eq. 9
        adam.step(stream, scene.parameters(), gradients.surfels, gradients.touched, rates_at(config.train, extent_m, step), step, model.sh_degree);
        stream.submit();
    }

    /// Mean loss terms over the last n iterations; starts over. Blocks.
    std::array<double, kLossTerms> take_terms(int n, int step) {
        stream.finish();
        const std::vector<float> sums = terms.download();
        std::array<double, kLossTerms> means{};
        for (int k = 0; k < kLossTerms; ++k) {
            means[std::size_t(k)] = sums[std::size_t(k)] / std::max(n, 1);
            if (!std::isfinite(sums[std::size_t(k)]))
                throw DataError(fmt::format("training, iterations {} to {}: the {} loss is {}, expected a finite number", step - n + 1, step, kLossTermNames[std::size_t(k)], sums[std::size_t(k)]));
        }
        if (const std::uint32_t capped = forward.take_pass_cap_count())
            throw DeviceError(fmt::format("training, iterations {} to {}: {} rays reached the cap of passes, expected every ray to end", step - n + 1, step, capped));
        terms.upload(std::vector<float>(kLossTerms, 0.0f));
        return means;
    }
};

TrainProgress progress_at(int step, const Config& config, double seconds, const std::array<double, kLossTerms>& terms, std::uint32_t n_surfels) {
    TrainProgress p;
    p.iteration = step;
    p.n_iterations = config.train.iterations;
    p.seconds = seconds;
    p.iterations_per_second = step / std::max(seconds, 1e-9);
    p.eta_s = (config.train.iterations - step) / std::max(p.iterations_per_second, 1e-9);
    p.terms = terms;
    p.loss = std::accumulate(terms.begin(), terms.end(), 0.0);
    p.n_surfels = n_surfels;
    return p;
}

}  // namespace

TrainResult train(Device& device, const Sequence& sequence, const Split& split, const Config& config, const ProgressCallback& progress) {
    if (split.train.empty()) throw DataError(fmt::format("training on {}: found no training frames, expected at least one", sequence.name));
    TrainResult result;
    const Clock::time_point begin = Clock::now();
    const Scene initial = make_background_scene(initialise_background(sequence, split.train, config.init));
    result.initialise_s = seconds_since(begin);

    Loop loop(device, sequence, split, initial, config);
    loop.terms.upload(std::vector<float>(kLossTerms, 0.0f));
    const Clock::time_point start = Clock::now();
    int logged = 0;
    for (int step = 1; step <= config.train.iterations && !result.interrupted; ++step) {
        loop.iterate(step);
        const bool log_now = step == 1 || step % std::max(1, config.train.log_every) == 0 || step == config.train.iterations;
        if (!log_now) continue;
        const std::array<double, kLossTerms> terms = loop.take_terms(step - logged, step);
        logged = step;
        result.log.push_back(progress_at(step, config, seconds_since(start), terms, loop.scene.size()));
        result.interrupted = !progress(result.log.back());
    }
    loop.stream.finish();
    result.train_s = seconds_since(start);
    result.scene = loop.scene.layout();
    result.scene.surfels = loop.scene.parameters().download();
    result.times = loop.stream.times();
    result.peak_device_bytes = device.peak_bytes();
    return result;
}

}  // namespace relidar
