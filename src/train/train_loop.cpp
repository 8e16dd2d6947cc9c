// SPDX-License-Identifier: Apache-2.0
// One iteration: sample a frame, render its rays, compare, differentiate, step (docs/method.md sections 4-6). One submission an
// iteration, and no wait: what the host must know of it comes a few iterations later (readback_lag.hpp).
#include "train/train_loop.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/run.hpp>

#include "train/readback_lag.hpp"
#include "train/sensor_drop.hpp"

namespace relidar {

FrameSampler::FrameSampler(std::size_t n, std::uint64_t seed) : order_(n), random_(seed) { std::iota(order_.begin(), order_.end(), std::uint64_t(0)); }

std::size_t FrameSampler::next() {
    if (position_ == 0)
        for (std::size_t i = order_.size(); i > 1; --i) std::swap(order_[i - 1], order_[random_.next() % i]);
    const std::size_t frame = order_[position_];
    position_ = (position_ + 1) % order_.size();
    return frame;
}

bool FrameSampler::is_sound(std::size_t n) const {
    std::vector<std::uint64_t> sorted = order_, all(n);
    std::sort(sorted.begin(), sorted.end());
    std::iota(all.begin(), all.end(), std::uint64_t(0));
    return sorted == all && position_ < n;
}

namespace {

constexpr int kGrowthEvery = 32;   // iterations between two looks at how the tree has grown

LearningRates rates_at(const TrainConfig& c, double extent_m, int step) {
    const double decay = exponential_schedule(1.0, c.rate_decay, step, c.iterations);
    return {exponential_schedule(c.mean_rate, c.mean_rate_final, step, c.iterations) * extent_m, c.rotation_rate * decay, c.scale_rate * decay,
            c.opacity_rate * decay, c.sh_rate * decay, c.sh_rest_factor};
}

/// Active degree of the spherical harmonics; the image's own may be lower.
int sh_degree_at(const TrainConfig& c, int step) { return c.sh_degree_start + std::max(step - 1, 0) / std::max(1, c.sh_degree_interval); }

ImageModel with_degree(ImageModel model, int degree) {
    model.sh_degree = std::min(model.sh_degree, degree);
    return model;
}

TraceOptions training_options(const Config& config) {
    TraceOptions options = trace_options(config);
    options.geometry = config.loss.uses_geometry();
    return options;
}

Unknown unknown(const Sequence& sequence, const Split& split, const Scene& scene, const Config& config) {
    Unknown masks{config.init, {}, config.train.sensor_drop ? observed_drops(sequence, split.train) : DropTable{}};
    for (const Instance& instance : scene.instances)
        if (!instance.track.empty()) masks.actors.push_back(instance.track);
    return masks;
}

}  // namespace

TrainLoop::TrainLoop(Device& device, const Sequence& sequence, const Split& split, const Scene& initial, const Config& config)
    : config_(config),
      frames_(upload_frames(device, sequence, split.train, unknown(sequence, split, initial, config))),
      stream_(device, true),
      scene_(device, initial),
      accel_(std::in_place, device, scene_, accel_options(config)),
      forward_(device, config.image, accel_->proxy(), training_options(config)),
      batches_(device, config, frames_),
      loss_(device, config.loss, largest_batch()),
      chamfer_(device, config.loss, largest_batch()),
      backward_(device, config.image, accel_->proxy(), training_options(config), backward_options(config)),
      surfel_loss_(device, config.loss),
      adam_(device, scene_.size(), {.only_touched = config.train.only_touched}, scene_.primitive()),
      rendered_(device, largest_batch(), "rendered rays"),
      kept_(device, largest_batch(), static_cast<std::uint32_t>(config.trace.keep_hits)),
      upstream_(device, largest_batch(), "loss gradients"),
      reports_(device),
      extent_m_(config.train.extent_m > 0.0 ? config.train.extent_m : background_extent(initial)),
      sampler_(frames_.size(), config.train.seed) {
    if (config.loss.uses_geometry()) {
        geometry_.emplace(device, largest_batch());
        geometry_loss_.emplace(device, config.loss, largest_batch());
    }
    if (config.train.refine_poses != "none") refiner_.emplace(device, sequence, initial, config.train, frames_);
    make_gradients();
    for (FrameData& frame : frames_) {
        const Frame& turn = sequence.frames[std::size_t(frame.position)];
        frame.placed = place_instances(initial, sequence, turn.time_s, turn.lidar);
    }
    if (config.densify.strategy != DensifyStrategy::none || config.densify.prune_unseen)
        densifier_.emplace(device, initial, config.densify, config.image.alpha_min, static_cast<std::uint32_t>(frames_.size()), config.train.seed);
}

TrainLoop::~TrainLoop() {
    try {
        stream_.wait(submitted_);   // where training ends by an exception, the device may still use the arrays
    } catch (const DeviceError&) {
        // a lost device uses nothing any more, and has been reported
    }
}

std::uint32_t TrainLoop::largest_batch() const {
    std::uint32_t largest = 0;
    for (const FrameData& frame : frames_) largest = std::max(largest, frame.n_rays);
    return largest;
}

/// Terms of the surfels themselves reach those that no ray has met.
bool TrainLoop::all_have_gradients() const { return config_.loss.uses_surfels() && !config_.train.only_touched; }

void TrainLoop::make_gradients() {
    gradients_.emplace(stream_.device(), scene_, refiner_ ? refiner_->wanted(largest_batch()) : WantedGradients{});
    gradients_->zero_untouched = all_have_gradients();
}

void TrainLoop::place(std::size_t frame_index, const ImageModel& model) {
    FrameData& frame = frames_[frame_index];
    if (refiner_) refiner_->place(stream_, frame_index, frame);
    scene_.place(stream_, frame.placed);                          // Eq. 4-5
    scene_.activate(stream_, model, frame.sensor_position_m);
    accel_->update(stream_, scene_);
}

void TrainLoop::render_and_compare(const RayBatch& rays, const TargetBatch& targets, const TermRow& terms) {
    RayGeometry* geometry = geometry_ ? &*geometry_ : nullptr;
    forward_.run(stream_, scene_, *accel_, rays, rendered_, &kept_, geometry);                                             // Eq. 2-4
    loss_.run(stream_, targets, rendered_, upstream_, terms);                                                              // Eq. 10
    if (geometry) geometry_loss_->run(stream_, rays, targets, rendered_, *geometry, upstream_, terms);
}

void TrainLoop::iterate(int step, bool ends_line) {
    look_at_reports(step - kReadbackLag);
    if (refiner_) refiner_->take_steps(stream_, step - kReadbackLag);
    const std::size_t frame_index = sampler_.next();
    const FrameData& frame = frames_[frame_index];
    const ImageModel model = with_degree(config_.image, sh_degree_at(config_.train, step));
    forward_.set_sh_degree(model.sh_degree);
    backward_.set_sh_degree(model.sh_degree);

    place(frame_index, model);
    const SampledBatch batch = batches_.sample(stream_, frame, sampler_.random());
    const auto& [rays, targets, window] = batch;
    const TermRow terms = reports_.row();
    render_and_compare(rays, targets, terms);
    chamfer_.run(stream_, rays, targets, rendered_, upstream_, terms);                                                     // Eq. 11
    backward_.run(stream_, scene_, *accel_, rendered(rays), frame.sensor_position_m, *gradients_);                         // Eq. 9
    if (refiner_) refiner_->record(stream_, frame_index, frame, batch, *gradients_, step);
    surfel_loss_.run(stream_, scene_, {&gradients_->surfels, config_.train.only_touched ? &gradients_->touched : nullptr}, terms);
    if (densifier_) densifier_->observe(stream_, scene_, {&gradients_->surfels, &gradients_->touched, static_cast<std::uint32_t>(frame_index), rays.n_rays == frame.n_rays});
    const LearningRates rates = rates_at(config_.train, extent_m_, step);
    adam_.step(stream_, scene_.parameters(), gradients_->surfels, all_have_gradients() ? nullptr : &gradients_->touched, rates, step, model.sh_degree);
    reports_.add(step, frame.index);
    if (densifier_ && densifier_->due(step)) change_surfels([&](double others_bytes) { return densifier_->run(stream_, scene_, adam_, step, others_bytes); });
    if (densifier_) densifier_->after_step(stream_, scene_, adam_, step, rates.mean / std::max(config_.train.mean_rate * extent_m_, 1e-30));
    if (ends_line || reports_.is_full()) close_report(step, ends_line);
    if (step % kGrowthEvery == 0) accel_->check_growth(stream_);
    submitted_ = stream_.submit();
    last_step_ = step;
}

/// What is sized for the surfels of the scene goes before they change, and comes back for the new number of them.
template <class Change>
void TrainLoop::change_surfels(const Change& change) {
    Device& device = stream_.device();
    stream_.finish();
    const std::uint64_t before = device.allocated_bytes();
    accel_.reset();
    gradients_.reset();
    const double others_bytes = double(before - device.allocated_bytes()) / std::max(scene_.size(), 1u);
    densified_.add(change(others_bytes));
    make_gradients();
    accel_.emplace(device, scene_, accel_options(config_));
}

void TrainLoop::prune_unseen() {
    densifier_->forget(stream_);
    const ImageModel model = with_degree(config_.image, sh_degree_at(config_.train, config_.train.iterations));
    for (std::size_t i = 0; i < frames_.size(); ++i) {
        const FrameData& frame = frames_[i];
        const RayBatch rays = frame.batch(0, 1);
        place(i, model);
        render_and_compare(rays, {&frame.targets, 0, 1, frame.n_rays, frame.n_returned, frame.n_known, frame.image}, reports_.row());
        backward_.run(stream_, scene_, *accel_, rendered(rays), frame.sensor_position_m, *gradients_);
        densifier_->observe(stream_, scene_, {&gradients_->surfels, &gradients_->touched, static_cast<std::uint32_t>(i), true});
        stream_.submit();
    }
    change_surfels([&](double) { return densifier_->prune_unseen(stream_, scene_, adam_); });
}

void TrainLoop::close_report(int step, bool ends_line) {
    const DeviceCounts counts{&forward_.pass_cap_count(), config_.train.deterministic ? backward_.most_hits() : nullptr, backward_.hit_capacity()};
    reports_.close(stream_, counts, ends_line ? std::optional(LogLine{step, {}, n_surfels(), std::exchange(densified_, {})}) : std::nullopt);
}

void TrainLoop::look_at_reports(int last) {
    while (const std::optional<IterationReports::Report> report = reports_.take(stream_, last)) {
        if (report->pass_cap > 0)
            throw DeviceError(fmt::format("training, iterations {} to {}: {} rays reached the cap of passes or filled the traversal stack, expected every ray to end", report->first_step, report->last_step, report->pass_cap));
        check_room(*report);
    }
}

void TrainLoop::check_room(const IterationReports::Report& report) {
    if (report.most_hits > report.hit_capacity)
        throw DeviceError(fmt::format("training, iterations {} to {}, in a fixed order: found {} hits in one of them, expected at most {}; train.gather_hits={} makes room",
                                      report.first_step, report.last_step, report.most_hits, report.hit_capacity, report.most_hits / std::max(1u, config_.train.rays_per_iteration > 0 ? static_cast<std::uint32_t>(config_.train.rays_per_iteration) : largest_batch()) + 1));
    if (report.most_hits <= backward_.hit_capacity() / 2) return;
    close_report(last_step_, false);   // of iterations that had the room there is now
    backward_.reserve_hits(stream_, 2 * std::uint64_t(report.most_hits));   // before it is needed
}

void TrainLoop::settle() {
    close_report(last_step_, false);
    submitted_ = stream_.submit();
    look_at_reports(last_step_);
    if (refiner_) refiner_->fetch(stream_);
    stream_.wait(submitted_);
}

void TrainLoop::finish() {
    settle();
    if (refiner_) refiner_->take_steps(stream_, last_step_);
}

void TrainLoop::save(Checkpoint& checkpoint) {
    settle();
    checkpoint.texts["layout"] = layout_to_json(scene_.layout());
    visit_state(StateWriter(checkpoint));
}

void TrainLoop::restore(const Checkpoint& checkpoint) {
    settle();   // of the steps this state replaces
    visit_state(StateReader(checkpoint));
    last_step_ = checkpoint.iteration;
    if (!sampler_.is_sound(frames_.size()) || !reports_.is_sound())
        throw DataError(fmt::format("resuming from iteration {}: the order of frames or the sums of losses are not those of {} frames and {} terms", checkpoint.iteration, frames_.size(), kLossTerms));
    if (refiner_ && !refiner_->take_over()) throw DataError(fmt::format("resuming from iteration {}: the corrections of poses are not those of this log", checkpoint.iteration));
}

DropTable TrainLoop::estimate_sensor_drop(const Sequence& sequence) {
    constexpr std::uint32_t kRays = 20000;   // of each frame: hundreds a bin over a log
    constexpr float kSolid = 0.9f;           // a ray must meet this much of a surface
    const ImageModel model = with_degree(config_.image, sh_degree_at(config_.train, config_.train.iterations));
    DropCounts counts(sequence);
    for (std::size_t k = 0; k < frames_.size(); ++k) {
        const FrameData& frame = frames_[k];
        const Frame& turn = sequence.frames[std::size_t(frame.position)];
        const std::uint32_t stride = std::max(1u, frame.n_rays / kRays), first = static_cast<std::uint32_t>(sampler_.random().next() % stride);
        const RayBatch rays = frame.batch(first, stride);
        place(k, model);
        forward_.run(stream_, scene_, *accel_, rays, rendered_, nullptr, geometry_ ? &*geometry_ : nullptr);
        stream_.finish();
        const Rendering r = to_rendering(rendered_.download(rays.n_rays));
        for (std::uint32_t j = 0; j < rays.n_rays; ++j) {
            const std::size_t i = first + std::size_t(j) * stride;
            if (r.weight[j] > kSolid && r.hit_logit[j] > r.drop_logit[j]) counts.add(turn, i);
        }
    }
    return counts.shrunk();
}

Scene TrainLoop::download() {
    stream_.finish();
    Scene scene = scene_.layout();
    scene.surfels = scene_.parameters().download();
    return scene;
}

}  // namespace relidar
