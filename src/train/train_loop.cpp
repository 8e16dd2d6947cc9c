// SPDX-License-Identifier: Apache-2.0
// Runs a training iteration: selects a frame, renders its rays, computes losses and
// gradients, and updates the parameters (docs/method.md sections 4-6). The host submits
// each iteration to the GPU without waiting for it. The host reads the losses a few
// iterations later (readback_lag.hpp).
#include "train/train_loop.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>

#include "train/readback_lag.hpp"

namespace relidar {

FrameSampler::FrameSampler(std::size_t count, std::uint64_t seed) : order_(count), random_(seed) {
    std::iota(order_.begin(), order_.end(), std::uint64_t(0));
}

std::size_t FrameSampler::next() {
    if (position_ == 0)
        for (std::size_t i = order_.size(); i > 1; --i) std::swap(order_[i - 1], order_[random_.next() % i]);
    const std::size_t frame = order_[position_];
    position_ = (position_ + 1) % order_.size();
    return frame;
}

std::optional<std::size_t> FrameSampler::peek_next_frame() const {
    return position_ == 0 ? std::nullopt : std::optional(std::size_t(order_[position_]));
}

bool FrameSampler::is_sound(std::size_t count) const {
    std::vector<std::uint64_t> sorted = order_, all(count);
    std::sort(sorted.begin(), sorted.end());
    std::iota(all.begin(), all.end(), std::uint64_t(0));
    return sorted == all && position_ < count;
}

namespace {

/// Learning rate of the higher spherical harmonics, relative to the rate of the constant
/// coefficient. The factor is a twentieth, as in 3D Gaussian splatting. The rate is low
/// because few views observe how the intensity depends on the direction.
constexpr double kShRestFactor = 0.05;

// Number of iterations between two checks of how much the acceleration structure has
// grown.
constexpr int kGrowthEvery = 32;

LearningRates compute_learning_rates(const TrainConfig& config, double extent_m, int step) {
    const double decay = interpolate_exponentially(1.0, config.rate_decay, step, config.iterations);
    return {
        .mean = interpolate_exponentially(config.mean_rate, config.mean_rate_final, step, config.iterations) *
                extent_m,
        .rotation = config.rotation_rate * decay,
        .log_scale = config.scale_rate * decay,
        .opacity_logit = config.opacity_rate * decay,
        .sh = config.sh_rate * decay,
        .sh_rest_factor = kShRestFactor,
        .gait = LearningRates{}.gait * decay,
        .intensity_factor = config.intensity_factor};
}

/// Returns the learning rate of the surfel positions for each model, relative to the rate
/// of the background. The rate is proportional to the extent of the model. Steps suitable
/// for a street would move an actor's surfels out of its box. The paper's rate is used if
/// surfels are cloned and split by fractions of this extent, as in the paper. A dense
/// initialisation uses a tenth of the paper's rate.
/// @return [models] factors
std::vector<float> compute_mean_factors(const Scene& layout, double background_extent_m) {
    std::vector<float> factors;
    for (const Model& model : layout.models)
        factors.push_back(
            model.half_size_m.x > 0.0f
                ? static_cast<float>(compute_box_extent(model.half_size_m) / background_extent_m)
                : 1.0f);
    return factors;
}

/// Returns the degree of the spherical harmonics that is active in a training step. The
/// image model can limit the degree further.
int get_sh_degree_at(const TrainConfig& config, int step) {
    return config.sh_degree_start + std::max(step - 1, 0) / std::max(1, config.sh_degree_interval);
}

/// Describes how often the acceleration structures are refitted to the moving surfels.
/// Between two refits, a margin around the surfels' boxes prevents missed hits.
struct TreeFits {
    int every = 1;  ///< iterations between two refits
    AccelOptions accel;
};

/// Returns the refit interval and the margins. In one iteration, a surfel moves by
/// millimetres and grows by a few per cent. A surfel that has just become visible can
/// outgrow the margin. Rays hit it again after the next refit. If most surfels are fixed,
/// the interval is longer, because refitting for few trained surfels would take most of
/// the time. Without per-surfel harmonics, every iteration refits, because only a refit
/// updates the hit records.
TreeFits choose_tree_fits(const Config& config, std::uint32_t n_fixed) {
    if (config.image.sh_direction == ShDirection::ray) return {};
    if (n_fixed > 0) return {4, {.margin_scale = 1.1f, .margin_m = 0.01f}};
    return {2, {.margin_scale = 1.05f, .margin_m = 0.003f}};
}

/// Returns true if the acceleration structures must be refitted in this step. Refits in
/// every step while the learning rate is so high that surfels could outgrow the margin.
bool should_fit_tree(const TreeFits& fits, const TrainConfig& config, int step) {
    // Share of the tree's margin that surfels may use by growing before a refit. The
    // remainder is needed because rising opacity also enlarges surfels.
    constexpr double kShare = 0.9;
    const double growth = (fits.every - 1) * compute_learning_rates(config, 1.0, step).log_scale;
    return growth > kShare * std::log(fits.accel.margin_scale) || (step - 1) % fits.every == 0;
}

RendererOptions make_renderer_options(const Config& config, const TrainingFrames& frames,
                                      std::uint32_t n_fixed) {
    return {.accel = choose_tree_fits(config, n_fixed).accel,
            .trace = make_training_trace_options(config),
            .n_rays = find_max_rays(frames.all()),
            .keep_hits = static_cast<std::uint32_t>(config.trace.keep_hits)};
}

/// Returns the maximum scale of each surfel, proportional to its initial scale. Surfels
/// close to each other start small and need little growth. Surfels far apart must be able
/// to close the holes between them.
std::vector<float> compute_scale_limits(const Surfels& surfels, double max_growth) {
    std::vector<float> bounds;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        float largest = std::max(surfels.log_scale[i].x, surfels.log_scale[i].y);
        if (get_primitive_kind(surfels.primitive).third_scale)
            largest = std::max(largest, surfels.log_scale_w[i]);
        bounds.push_back(largest + static_cast<float>(std::log(max_growth)));
    }
    return bounds;
}

/// Returns true if every surfel gets a gradient in each iteration, even if no ray hits
/// it. The box loss has this effect, because it depends only on the surfels.
bool has_dense_gradients(const Config& config) {
    return config.loss.box > 0.0f && !config.train.only_touched;
}

Unknown make_mask_rules(const Sequence& sequence, const Split& split, const Scene& scene,
                        const Config& config) {
    Unknown masks{config.init,
                  {},
                  config.train.sensor_drop ? estimate_observed_drops(sequence, split.train) : DropTable{}};
    for (const Instance& instance : scene.instances)
        if (!instance.track.empty()) masks.actors.push_back(instance.track);
    return masks;
}

/// Returns the range grid whose cells are used as training rays, or nothing if training
/// uses the rays of the sensor.
/// @throws UsageError if another setting requires the rays of the sensor
std::optional<RangeGrid> get_trained_grid(const Config& config) {
    if (config.train.grid == "native") return std::nullopt;
    const std::pair<bool, const char*> needs_sensor_rays[] = {
        {config.train.sensor_drop, "train.sensor_drop"}, {config.blocks.length_m > 0.0, "blocks.length_m"}};
    for (const auto& [is_set, setting] : needs_sensor_rays)
        if (is_set)
            throw UsageError(fmt::format(
                "the setting train.grid={} cannot be combined with {}, which needs the rays of the "
                "sensor (train.grid=native)",
                config.train.grid, setting));
    return find_grid(config.train.grid);
}

FrameUse choose_frame_use(const Sequence& sequence, const Split& split, const Scene& scene,
                          const Config& config) {
    return {.unknown = make_mask_rules(sequence, split, scene, config),
            .moves_rays = config.train.refines("sensor"),
            .resident_bytes = std::uint64_t(config.train.frame_memory_mib) << 20,
            .grid = get_trained_grid(config)};
}

}  // namespace

TrainLoop::TrainLoop(Device& device, const Sequence& sequence, const Split& split, const Scene& initial,
                     const Config& config, std::uint32_t n_fixed, std::optional<double> extent_m)
    : config_(config),
      n_fixed_(n_fixed),
      frames_(device, sequence, split.train, choose_frame_use(sequence, split, initial, config)),
      batches_(device, config, frames_.all()),
      refiner_(device, sequence, initial, config.train, frames_),
      differentiable_(device, initial, config.image, make_renderer_options(config, frames_, n_fixed),
                      {make_backward_options(config), refiner_.wanted(), has_dense_gradients(config)}),
      renderer_(differentiable_.renderer()),
      stream_(renderer_.stream()),
      losses_(make_losses(device, config.loss, find_max_rays(frames_.all()))),
      adam_(device, n_surfels(), {.only_touched = config.train.only_touched, .n_fixed = n_fixed},
            initial.surfels.parameters()),
      densifier_(device, initial, config.densify, config.image.alpha_min,
                 static_cast<std::uint32_t>(frames_.all().size()), config.train.seed),
      reports_(device),
      extent_m_(extent_m ? *extent_m : compute_background_extent(initial)),
      sampler_(frames_.all().size(), config.train.seed) {
    for (std::size_t i = 0; i < frames_.all().size(); ++i)
        frames_[i].placed = place_instances(
            initial, sequence, get_sweep_moment(sequence.frames[std::size_t(frames_[i].position)]));
    // Limits the size of surfels. With densification, large surfels are split, so no
    // limit is needed.
    if (config.densify.strategy == DensifyStrategy::none)
        adam_.bound_scales(device, compute_scale_limits(initial.surfels, config.train.max_growth));
}

TrainLoop::~TrainLoop() {
    try {
        // Waits for the device, because it may still use the arrays if training ended
        // with an exception.
        stream_.finish();
    } catch (const Error&) {
        // Ignores the error, because it was already reported. A lost device no longer
        // uses the arrays.
    }
}

const FrameData& TrainLoop::make_resident(std::size_t frame_index, bool surfels_changed) {
    FrameData& frame = frames_.make_resident(stream_, frame_index);
    refiner_.place(stream_, frame);
    if (surfels_changed) renderer_.place(frame.placed, frame.sensor_position_m);
    else renderer_.move(frame.placed, frame.sensor_position_m);
    return frame;
}

const FrameData& TrainLoop::place(std::size_t frame_index, int step) {
    renderer_.set_sh_degree(get_sh_degree_at(config_.train, step));
    return make_resident(frame_index,
                         should_fit_tree(choose_tree_fits(config_, n_fixed_), config_.train, step));
}

void TrainLoop::record_batch(const RayBatch& rays, const TargetBatch& targets, const TermRow& terms) {
    renderer_.record_forward(rays);  // renders the batch (equations 2-4)
    // Computes the losses (equations 10-11).
    for (const std::unique_ptr<Loss>& loss : losses_)
        loss->compare(stream_, differentiable_.batch(), targets, terms);
    differentiable_.record_backward();  // computes the gradients (equation 9)
}

void TrainLoop::run_iteration(int step, bool ends_line) {
    check_iteration_reports(step - kReadbackLag);
    refiner_.apply_steps(stream_, step - kReadbackLag);
    const std::size_t frame_index = sampler_.next();
    DeviceScene& scene = renderer_.scene();

    const FrameData& frame = place(frame_index, step);
    if (const std::optional<std::size_t> coming = sampler_.peek_next_frame()) frames_.expect(*coming);
    const SampledBatch batch = batches_.sample(stream_, frame, sampler_.random());
    const TermRow terms = reports_.row();
    record_batch(batch.rays, batch.targets, terms);
    Gradients& gradients = differentiable_.gradients();
    refiner_.record(stream_, frame_index, frame, batch, gradients, step);
    for (const std::unique_ptr<Loss>& loss : losses_)
        loss->regularise(stream_, scene,
                         {&gradients.surfels, config_.train.only_touched ? &gradients.touched : nullptr},
                         terms);
    const bool is_full_frame = batch.rays.n_rays == frame.n_rays;
    densifier_.observe(
        stream_, scene,
        {&gradients.surfels, &gradients.touched, static_cast<std::uint32_t>(frame_index), is_full_frame});
    LearningRates rates = compute_learning_rates(config_.train, extent_m_, step);
    if (config_.densify.strategy == DensifyStrategy::adaptive)
        rates.models = &scene.models(), rates.mean_factors = compute_mean_factors(scene.layout(), extent_m_);
    const Array<std::uint32_t, shared::TouchedSurfels>* touched =
        has_dense_gradients(config_) ? nullptr : &gradients.touched;
    adam_.step(stream_, scene.parameters(), gradients.surfels, touched, rates, step,
               renderer_.model().sh_degree);
    reports_.add(step, frame.index);
    if (densifier_.should_densify(step))
        change_surfels([&](double other_allocation_bytes) {
            return densifier_.run(stream_, scene, adam_, step, other_allocation_bytes);
        });
    densifier_.after_step(stream_, scene, adam_, step);
    if (ends_line || reports_.is_full()) request_report(step, ends_line);
    if (step % kGrowthEvery == 0) renderer_.accel().measure_tree_cost(stream_);
    submitted_ = stream_.submit();
    last_step_ = step;
}

void TrainLoop::change_surfels(const std::function<DensifyReport(double other_allocation_bytes)>& change) {
    differentiable_.change_surfels(
        [&](double other_allocation_bytes) { densified_.add(change(other_allocation_bytes)); });
}

void TrainLoop::request_report(int step, bool ends_line) {
    const BackwardPass& backward = differentiable_.backward_pass();
    const DeviceCounts counts{&renderer_.forward_pass().pass_cap_count(),
                              config_.train.deterministic ? backward.most_hits() : nullptr,
                              backward.hit_capacity(), &renderer_.forward_pass().overfull_count(),
                              renderer_.kept_hits()};
    reports_.close(stream_, counts,
                   ends_line ? std::optional(LogLine{step, {}, n_surfels(), std::exchange(densified_, {})})
                             : std::nullopt);
}

void TrainLoop::check_iteration_reports(int last) {
    while (const std::optional<IterationReports::Report> report = reports_.take(stream_, last)) {
        if (report->pass_cap > 0)
            throw DeviceError(fmt::format(
                "training failed in iterations {} to {}: {} rays exceeded the maximum number of "
                "traversal passes or the traversal stack; the scene may have too many overlapping surfels",
                report->first_step, report->last_step, report->pass_cap));
        adapt_hit_capacity(*report);
        increase_kept_hits(*report);
    }
}

void TrainLoop::adapt_hit_capacity(const IterationReports::Report& report) {
    if (report.most_hits > report.hit_capacity)
        throw DeviceError(fmt::format(
            "training failed in iterations {} to {} with train.deterministic=true: one iteration has "
            "{} hits, expected at most {}; use fewer rays per iteration (train.rays_per_iteration)",
            report.first_step, report.last_step, report.most_hits, report.hit_capacity));
    if (report.most_hits <= differentiable_.backward_pass().hit_capacity() / 2) return;
    // The capacity for hits changes now. Requests the report of the steps so far, because
    // they used the old capacity.
    request_report(last_step_, false);
    // Doubles the reserved space before the number of hits exceeds it.
    differentiable_.backward_pass().reserve_hits(stream_, 2 * std::uint64_t(report.most_hits));
}

void TrainLoop::increase_kept_hits(const IterationReports::Report& report) {
    // Ignores reports from before the last increase of the hits per ray.
    if (report.kept_hits != renderer_.kept_hits() || no_room_to_keep_more_) return;
    const std::uint32_t n_hits = recommend_kept_hits(report.kept_hits, report.overfull);
    if (n_hits == report.kept_hits) return;
    // The number of hits per ray changes now. Requests the report of the steps so far,
    // because they used the old number.
    request_report(last_step_, false);
    try {
        renderer_.keep_hits(n_hits);
    } catch (const OutOfDeviceMemory&) {
        no_room_to_keep_more_ = true;
    }
}

void TrainLoop::wait_for_iterations() {
    request_report(last_step_, false);
    submitted_ = stream_.submit();
    check_iteration_reports(last_step_);
    refiner_.fetch(stream_);
    stream_.wait(submitted_);
}

void TrainLoop::finish() {
    wait_for_iterations();
    refiner_.apply_steps(stream_, last_step_);
}

void TrainLoop::save(Checkpoint& checkpoint) {
    wait_for_iterations();
    checkpoint.texts["layout"] = layout_to_json(renderer_.scene().layout());
    visit_state(StateWriter(checkpoint));
}

void TrainLoop::restore(const Checkpoint& checkpoint) {
    // waits for pending iterations, because they would overwrite the restored state
    wait_for_iterations();
    visit_state(StateReader(checkpoint));
    last_step_ = checkpoint.iteration;
    if (!sampler_.is_sound(frames_.all().size()) || !reports_.is_sound())
        throw DataError(
            fmt::format("cannot resume from iteration {}: the stored frame order and loss sums do not fit {} "
                        "frames and {} loss terms",
                        checkpoint.iteration, frames_.all().size(), kLossTerms));
    refiner_.restore();
}

DropTable TrainLoop::estimate_sensor_drop(Device& device, const Sequence& sequence) {
    // Number of rays in a batch of one frame. In a full log, each bin of the drop table
    // then gets hundreds of rays.
    constexpr std::uint32_t kRays = 20000;
    // Minimum number of rays per bin of the drop table. A short log may need all its rays
    // for this.
    constexpr std::size_t kRaysPerBin = 20;
    Config some_rays = config_;
    some_rays.train.rays_per_iteration = kRays;
    // Turns the image loss off, because it needs a window of columns. Without it, a batch
    // contains rays of all directions.
    some_rays.loss.intensity_ssim = 0.0f;
    BatchSampler batches(device, some_rays, frames_.all());
    DropCounts counts(sequence);
    renderer_.set_sh_degree(get_sh_degree_at(config_.train, config_.train.iterations));
    // number of rays to use from each frame
    const std::size_t rays_of_frame =
        kRaysPerBin * counts.bins() / std::max<std::size_t>(1, frames_.all().size());
    for (std::size_t k = 0; k < frames_.all().size(); ++k) {
        // The last iteration moved the surfels, so the tree is refitted before the first
        // frame.
        const FrameData& frame = make_resident(k, k == 0);
        if (k + 1 < frames_.all().size()) frames_.expect(k + 1);
        const std::uint32_t first = batches.draw_first(frame, sampler_.random());
        const auto passes = static_cast<std::uint32_t>(
            std::clamp<std::size_t>(rays_of_frame / kRays, 1, batches.n_batches(frame)));
        for (std::uint32_t pass = 0; pass < passes; ++pass)
            count_dropped_rays(counts, sequence, frame, batches.take(stream_, frame, first, pass));
    }
    DropTable drops = counts.estimate_drop_rate();
    add_unseen_sectors(drops, frames_.unknown().observed_drops, sequence);
    return drops;
}

void TrainLoop::count_dropped_rays(DropCounts& counts, const Sequence& sequence, const FrameData& frame,
                                   const SampledBatch& batch) {
    // A ray hits a solid surface if its blending weight is above this value. Other rays
    // are not counted, except in blind directions, for which no surface was trained.
    constexpr float kSolid = 0.9f;
    const Frame& sweep = sequence.frames[std::size_t(frame.position)];
    const DropTable& observed = frames_.unknown().observed_drops;
    renderer_.record_forward(batch.rays);
    stream_.finish();
    const Rendering r = to_rendering(renderer_.rendered().rendered->download(batch.rays.n_rays));
    for (std::uint32_t j = 0; j < batch.rays.n_rays; ++j) {
        const std::size_t ray = batch.get_ray_of_frame(j);
        if (r.hit_logit[j] > r.drop_logit[j] &&
            (r.weight[j] > kSolid || is_blind(observed, sequence, sweep, ray)))
            counts.add(sweep, ray);
    }
}

}  // namespace relidar
