// SPDX-License-Identifier: Apache-2.0
// Runs a training iteration (docs/method.md sections 4-6). The host submits each
// iteration to the GPU without waiting, and reads the losses later.
#include "train/train_loop.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include <relidar/gpu/out_of_memory.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>

#include "base/fail.hpp"
#include "train/poses/register_options.hpp"
#include "train/reports/iteration_reports.hpp"

namespace relidar {

/// Starts with the frames in the order of the log. next_frame() shuffles them.
FrameSampler::FrameSampler(std::size_t count, std::uint64_t seed) : order_(count), random_(seed) {
    std::iota(order_.begin(), order_.end(), std::uint64_t(0));
}

/// Returns the next frame. Shuffles the order (Fisher-Yates) at the start of each epoch.
std::size_t FrameSampler::next_frame() {
    if (position_ == 0)
        for (std::size_t i = order_.size(); i > 1; --i)
            std::swap(order_[i - 1], order_[random_.next_uint64() % i]);
    const std::size_t frame = order_[position_];
    position_ = (position_ + 1) % order_.size();
    return frame;
}

std::optional<std::size_t> FrameSampler::peek_frame() const {
    return position_ == 0 ? std::nullopt : std::optional(std::size_t(order_[position_]));
}

namespace {

/// Relative to the rate of the constant coefficient. A twentieth, as in 3D Gaussian
/// splatting, because few views observe how the intensity depends on the direction.
constexpr double kShRestFactor = 0.05;

// Number of iterations between two measurements of the traversal cost of the tree. If the
// cost has grown too much, the tree is rebuilt.
constexpr int kGrowthEvery = 32;

/// Returns the learning rates of an iteration. All rates decay exponentially. The rate of
/// positions is relative to the extent of the scene, in metres.
LearningRates learning_rates(const TrainConfig& config, double extent_m, int step) {
    const double decay = interpolate_exp(1.0, config.rate_decay, step, config.iterations);
    return {
        .mean = interpolate_exp(config.mean_rate, config.mean_rate_final, step, config.iterations) * extent_m,
        .rotation = config.rotation_rate * decay,
        .log_scale = config.scale_rate * decay,
        .opacity_logit = config.opacity_rate * decay,
        .sh = config.sh_rate * decay,
        .sh_rest_factor = kShRestFactor,
        .gait = LearningRates{}.gait * decay,  // the default; it is no setting
        .intensity_factor = config.intensity_factor};
}

/// Returns the learning rate of positions for each model, relative to the rate of the
/// background. As in the paper, it is proportional to the extent of the model: steps
/// suitable for a street would move an actor's surfels out of its box.
/// @return [models] factors
std::vector<float> position_factors(const Scene& scene_layout, double background_extent_m) {
    std::vector<float> factors;
    for (const SurfelModel& model : scene_layout.models) {
        const bool is_actor = model.half_size_m.x > 0.0f;
        const double ratio = is_actor ? actor_extent_m(model.half_size_m) / background_extent_m : 1.0;
        factors.push_back(static_cast<float>(ratio));
    }
    return factors;
}

/// Returns the degree of spherical harmonics that an iteration trains. It starts low and
/// increases by one after each interval.
int active_sh_degree(const TrainConfig& config, int step) {
    return config.sh_degree_start + std::max(step - 1, 0) / std::max(1, config.sh_degree_interval);
}

/// A margin around the surfels' boxes prevents missed hits between two refits.
struct TreeRefitSchedule {
    int every = 1;  ///< iterations between two refits
    AccelOptions accel;
};

/// Returns how often the tree is refitted, and its margin. In one iteration, a surfel
/// moves by millimetres and grows by a few per cent. If most surfels are fixed, refits
/// would take most of the time. If spherical harmonics are evaluated per ray, only a
/// refit updates the surfel records, so every iteration refits.
TreeRefitSchedule choose_refit(const Config& config, std::uint32_t n_fixed_surfels) {
    if (config.image.sh_direction == ShDirection::ray) return {};
    if (n_fixed_surfels > 0) return {.every = 4, .accel = {.margin_scale = 1.1f, .margin_m = 0.01f}};
    return {.every = 2, .accel = {.margin_scale = 1.05f, .margin_m = 0.003f}};
}

/// Returns true if the tree must be refitted in this step. It is refitted in every step
/// while the learning rate is so high that surfels could outgrow the margin.
bool is_refit_due(const TreeRefitSchedule& refit_options, const TrainConfig& config, int step) {
    // Share of the margin that is for a growing scale. The remainder is for a growing
    // opacity, because a more opaque surfel also needs a larger box.
    constexpr double kScaleShareOfMargin = 0.9;
    const double growth = (refit_options.every - 1) * learning_rates(config, 1.0, step).log_scale;
    return growth > kScaleShareOfMargin * std::log(refit_options.accel.margin_scale) ||
           (step - 1) % refit_options.every == 0;
}

/// Returns the logarithm of the maximum scale of each surfel, which is proportional to
/// its initial scale. Surfels close to each other start small and need little growth.
/// Surfels far apart must be able to fill the gaps between them.
std::vector<float> log_scale_limits(const Surfels& surfels, double max_growth_factor) {
    std::vector<float> bounds;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        float largest = std::max(surfels.log_scale[i].x, surfels.log_scale[i].y);
        if (properties_of(surfels.primitive).third_scale) largest = std::max(largest, surfels.log_scale_w[i]);
        bounds.push_back(largest + static_cast<float>(std::log(max_growth_factor)));
    }
    return bounds;
}

/// The box loss gives every surfel a gradient, even if no ray hits it.
bool has_dense_gradients(const Config& config) {
    return config.loss.box > 0.0f && !config.train.only_touched;
}

/// Returns the rule that selects measurements which training ignores: rays that the
/// sensor itself usually drops, and returns in moving boxes without a model.
IgnoredMeasurements training_mask(const Log& log, const Split& split, const Scene& scene,
                                  const Config& config) {
    IgnoredMeasurements masks = mask_movers(config, scene);
    if (config.train.sensor_drop) masks.observed_drops = measure_drops(log, split.train);
    return masks;
}

/// Returns the motions of the vehicle that the scans do not show, so that training does
/// not change them.
std::vector<std::vector<UnobservedMotion>> unobserved_motions(const Log& log, const Split& split,
                                                              const Config& config) {
    if (!config.train.refines("sensor")) return {};
    return find_unobserved_motions(log, split.train, registration_options(log, config));
}

/// Returns the grid whose cells are used as training rays, or nothing if training uses
/// the rays of the sensor.
/// @throws UsageError if another setting requires the rays of the sensor
std::optional<RangeImageGrid> training_grid(const Config& config) {
    if (config.train.grid == "native") return std::nullopt;
    const auto reject_if = [&](bool is_set, const char* setting) {
        if (is_set)
            fail<UsageError>(
                "the setting train.grid={} cannot be combined with {}, which needs the rays of the sensor "
                "(train.grid=native)",
                config.train.grid, setting);
    };
    reject_if(config.train.sensor_drop, "train.sensor_drop");
    reject_if(config.blocks.length_m > 0.0, "blocks.length_m");
    return find_grid(config.train.grid);
}

}  // namespace

/// Allocates everything that training needs: frames on the device, renderer with
/// gradients, losses, optimizer and densification. The order of the members matters,
/// because later members use earlier ones.
TrainLoop::TrainLoop(Device& device, const Log& log, const Split& split, const Scene& initial,
                     const Config& config, std::uint32_t n_fixed_surfels, std::optional<double> extent_m)
    : config_(config),
      n_fixed_(n_fixed_surfels),
      // The training frames, batches of their rays, and corrections of their poses.
      frames_(device, log, split.train,
              {.unknown = training_mask(log, split, initial, config),
               .moves_rays = config.train.refines("sensor"),
               .resident_bytes = std::uint64_t(config.train.frame_memory_mib) << 20,
               .grid = training_grid(config)}),
      batches_(device, config, frames_.all()),
      refiner_(device, log, initial, config.train, frames_, unobserved_motions(log, split, config)),
      differentiable_(device, initial, config.image,
                      {.accel = choose_refit(config, n_fixed_surfels).accel,
                       .trace = training_options(config),
                       .n_rays = max_frame_rays(frames_.all()),
                       .keep_hits = static_cast<std::uint32_t>(config.trace.keep_hits)},
                      {backward_options(config), refiner_.required_gradients(), has_dense_gradients(config)}),
      renderer_(differentiable_.renderer()),
      stream_(renderer_.stream()),
      // The losses, and everything that changes the surfels.
      losses_(make_losses(device, config.loss, max_frame_rays(frames_.all()))),
      adam_(device, surfel_count(), {.only_touched = config.train.only_touched, .n_fixed = n_fixed_surfels},
            initial.surfels.parameters_used()),
      densifier_(device, initial, config.densify, config.image.alpha_min,
                 static_cast<std::uint32_t>(frames_.all().size()), config.train.seed),
      reports_(device),
      extent_m_(extent_m ? *extent_m : scene_extent_m(initial)),
      sampler_(frames_.all().size(), config.train.seed) {
    for (const std::unique_ptr<Loss>& loss : losses_) active_losses_.push_back(loss.get());
    // Poses and motions of the actors during the sweep of each frame.
    for (std::size_t i = 0; i < frames_.all().size(); ++i)
        frames_[i].placed =
            pose_instances(initial, log, timing_of(log.frames[std::size_t(frames_[i].position)]));
    adam_.set_logit_factors(logit_factors(initial, frames_.all(), config.train));
    // Densification splits large surfels, so it needs no limit.
    if (config.densify.strategy == DensifyStrategy::none)
        adam_.set_max_log_scales(device, log_scale_limits(initial.surfels, config.train.max_growth));
}

TrainLoop::~TrainLoop() {
    try {
        // The device may still use the arrays if training ended with an exception.
        stream_.submit_and_wait();
    } catch (const Error&) {
        // Already reported. A lost device no longer uses the arrays.
    }
}

const TrainingFrameData& TrainLoop::upload_frame(std::size_t frame_index, bool surfels_changed) {
    TrainingFrameData& frame = frames_.ensure_resident(stream_, frame_index);
    refiner_.move_frame(stream_, frame);
    if (surfels_changed) renderer_.update(frame.placed, frame.sensor_position_m);
    else renderer_.record_poses(frame.placed, frame.sensor_position_m);
    return frame;
}

/// Renders a batch, and computes its losses and their gradients with respect to the
/// surfels. Writes the value of each loss to the row of this iteration in the report.
void TrainLoop::record_losses(const SampledBatch& batch) {
    const LossTermRow terms = reports_.loss_row();
    renderer_.record_forward(batch.rays);
    for (Loss* loss : active_losses_)  // losses, and their gradients with respect to the rays' values
        loss->add_ray_losses(stream_, differentiable_.last_batch(), batch.targets, terms);
    differentiable_.record_backward();  // from the rays' values to the surfels
    // Losses of the surfels themselves, which add to the gradients of the rays. With
    // train.only_touched, they skip surfels that no ray of the batch hit.
    DeviceGradients& gradients = differentiable_.gradients();
    const auto* touched = config_.train.only_touched ? &gradients.touched : nullptr;
    for (Loss* loss : active_losses_)
        loss->add_regularisers(stream_, renderer_.scene(), {&gradients.surfels, touched}, terms);
}

/// Records one iteration and submits it: renders a batch, computes the losses and their
/// gradients, and updates the surfels. Adds and removes surfels at some steps. Does not
/// wait for the device, so results reach the host kReadbackLag iterations later.
void TrainLoop::run_iteration(int step, bool is_last_of_log_interval) {
    check_reports(step - kReadbackLag);
    refiner_.apply_until(stream_, step - kReadbackLag);

    const std::size_t frame_index = sampler_.next_frame();
    renderer_.set_sh_degree(active_sh_degree(config_.train, step));
    const bool is_refit = is_refit_due(choose_refit(config_, n_fixed_), config_.train, step);
    const TrainingFrameData& frame = upload_frame(frame_index, is_refit);  // at the corrected poses
    // Computes the arrays of the next frame on the host while the device works.
    if (const std::optional<std::size_t> next_frame = sampler_.peek_frame())
        frames_.prefetch_frame(*next_frame);

    const SampledBatch batch = batches_.draw_batch(stream_, frame, sampler_.generator());
    record_losses(batch);
    const DeviceGradients& gradients = differentiable_.gradients();
    refiner_.record_gradients(stream_, frame_index, frame, batch, gradients, step);
    densifier_.record_statistics(stream_, renderer_.scene(),
                                 {.gradients = &gradients.surfels,
                                  .touched = &gradients.touched,
                                  .frame = static_cast<std::uint32_t>(frame_index),
                                  .is_full_frame = batch.rays.n_rays == frame.n_rays});
    record_adam_step(step);
    densify_surfels(step);
    reports_.add_iteration(step, frame.index);
    if (is_last_of_log_interval)
        start_readback(TrainLogLine{
            .step = step, .n_surfels = surfel_count(), .densified = std::exchange(densified_, {})});
    else if (reports_.is_full()) start_readback();

    if (step % kGrowthEvery == 0) renderer_.accel().record_cost(stream_);
    submitted_ = stream_.submit_commands();
    last_step_ = step;
}

/// Records the update of the surfels by Adam.
void TrainLoop::record_adam_step(int step) {
    DeviceScene& scene = renderer_.scene();
    const DeviceGradients& gradients = differentiable_.gradients();
    LearningRates rates = learning_rates(config_.train, extent_m_, step);
    rates.models = &scene.model_table();
    // As in the paper, a training that densifies has a rate for each model.
    if (config_.densify.strategy == DensifyStrategy::adaptive)
        rates.mean_factors = position_factors(scene.layout(), extent_m_);
    // Skips surfels without a gradient, unless a loss gives every surfel a gradient.
    const auto* touched = has_dense_gradients(config_) ? nullptr : &gradients.touched;
    adam_.record_step(stream_, scene.surfel_parameters(), gradients.surfels, touched, rates, step,
                      renderer_.model().sh_degree);
}

/// Adds and removes surfels, and limits opacities, each at the steps of its interval.
void TrainLoop::densify_surfels(int step) {
    DeviceScene& scene = renderer_.scene();
    if (densifier_.is_densify_step(step))
        differentiable_.resize([&](double other_allocation_bytes) {
            densified_.add_counts(
                densifier_.densify_surfels(stream_, scene, adam_, step, other_allocation_bytes));
        });
    densifier_.reset_opacities(stream_, scene, adam_, step);
}

/// Ends the current report: starts to copy its losses and counters to the host. Does not
/// wait.
/// @param line  set if a log interval ends; gets the mean losses of the interval
void TrainLoop::start_readback(const std::optional<TrainLogLine>& line) {
    const ForwardPass& forward = renderer_.forward_pass();
    const BackwardPass& backward = differentiable_.backward_pass();
    const DeviceHitCounters counters{
        .n_truncated_rays = forward.n_truncated_rays(),
        .n_overflowed_rays = forward.n_overflowed_rays(),
        // Gradients of hits beyond hits_per_batch are added by atomics, in any order. A
        // deterministic training must avoid this, so it checks the number.
        .max_hits = config_.train.deterministic ? backward.max_hit_count() : nullptr};
    const HitLimits limits{.hits_per_batch = backward.hit_capacity(),
                           .hits_per_ray = renderer_.stored_hits_per_ray()};
    reports_.record_copy(stream_, counters, limits, line);
}

/// Reads all reports that are available up to `last_step`. Stops if rays lost hits, and
/// enlarges the memory for hits if it was nearly full.
void TrainLoop::check_reports(int last_step) {
    while (const std::optional<IterationReport> report = reports_.take_oldest(stream_, last_step)) {
        if (report->n_truncated_rays > 0)
            fail<DeviceError>(
                "training failed in iterations {} to {}: the search for surfels stopped {} times at its "
                "limit of passes or with a full stack; the scene probably has too many overlapping surfels",
                report->first_step, report->last_step, report->n_truncated_rays);
        grow_hit_capacity(*report);
        resize_stored_hits(*report);
    }
}

void TrainLoop::grow_hit_capacity(const IterationReport& report) {
    if (report.max_hits > report.limits.hits_per_batch)
        fail<DeviceError>(
            "training failed in iterations {} to {} with train.deterministic=true: one iteration has {} "
            "hits, expected at most {}; use fewer rays per iteration (train.rays_per_iteration)",
            report.first_step, report.last_step, report.max_hits, report.limits.hits_per_batch);
    if (report.max_hits <= differentiable_.backward_pass().hit_capacity() / 2) return;
    start_readback();  // ends the current report, because all its iterations have the same limits
    // Twice the reported number, so that later steps can have more hits.
    differentiable_.backward_pass().reserve_hits(stream_, 2 * std::uint64_t(report.max_hits));
}

void TrainLoop::resize_stored_hits(const IterationReport& report) {
    const std::uint32_t n_reported = report.limits.hits_per_ray;  // stored when the report's iterations ran
    const bool is_outdated = n_reported != renderer_.stored_hits_per_ray();
    if (is_outdated || hit_memory_exhausted_) return;
    const std::uint32_t n_hits = grow_stored_hits(n_reported, report.n_overflowed_rays);
    if (n_hits == n_reported) return;
    start_readback();  // ends the current report, because all its iterations have the same limits
    try {
        renderer_.set_stored_hits(n_hits);
    } catch (const OutOfDeviceMemory&) {
        hit_memory_exhausted_ = true;  // keeps the number of hits, and never tries again
    }
}

void TrainLoop::finish_steps() {
    start_readback();
    submitted_ = stream_.submit_commands();
    check_reports(last_step_);
    refiner_.wait_for_pending(stream_);
    stream_.wait_for(submitted_);
}

void TrainLoop::finish() {
    finish_steps();
    refiner_.apply_until(stream_, last_step_);
}

void TrainLoop::save_to(Checkpoint& checkpoint) {
    finish_steps();
    checkpoint.texts["layout"] = format_layout(renderer_.scene().layout());
    visit_state(CheckpointWriter(checkpoint));
}

void TrainLoop::restore_from(const Checkpoint& checkpoint) {
    // pending iterations would overwrite the restored state
    finish_steps();
    visit_state(CheckpointReader(checkpoint));
    last_step_ = checkpoint.iteration;
    refiner_.update_corrected();
}

RayDropTable TrainLoop::sensor_drop_rates(Device& device, const Log& log) {
    // In a long log, a batch of each or of every n-th frame suffices. In a short log,
    // several batches of a frame, or all, give each bin of the drop table (a beam and an
    // azimuth interval) about kRaysPerBin rays.
    constexpr std::uint32_t kRaysPerBatch = 20000;
    constexpr std::size_t kRaysPerBin = 20, kMaxFrames = 400;
    Config batch_config = config_;
    batch_config.train.rays_per_iteration = kRaysPerBatch;
    batch_config.loss.intensity_ssim = 0.0f;  // else a batch is a window, without rays of all directions
    const std::size_t n_frames = frames_.all().size();
    BatchSampler batches(device, batch_config, frames_.all());
    const RayDropTable& observed = frames_.mask_rules().observed_drops;
    std::vector<CheckedRay> rays;
    const std::size_t rays_per_frame =
        kRaysPerBin * observed.probability.size() / std::max<std::size_t>(1, n_frames);
    renderer_.set_sh_degree(active_sh_degree(config_.train, config_.train.iterations));
    const std::size_t frame_step = 1 + n_frames / kMaxFrames;
    for (std::size_t frame_index = 0; frame_index < n_frames; frame_index += frame_step) {
        // The last iteration moved the surfels, so the first frame refits the tree.
        const bool surfels_changed = frame_index == 0;
        const TrainingFrameData& frame = upload_frame(frame_index, surfels_changed);
        if (frame_index + frame_step < n_frames) frames_.prefetch_frame(frame_index + frame_step);
        const std::uint32_t start = batches.draw_start(frame, sampler_.generator());
        const auto n_batches = static_cast<std::uint32_t>(
            std::clamp<std::size_t>(rays_per_frame / kRaysPerBatch, 1, batches.count_batches(frame)));
        for (std::uint32_t batch = 0; batch < n_batches; ++batch)
            add_checked_rays(rays, log, frame, batches.gather(stream_, frame, start, batch));
    }
    RayDropTable drops = find_drop_excess(observed, rays);
    drop_unobserved(drops, observed, log);
    return drops;
}

/// Renders a batch. Appends its rays that find_drop_excess() checks.
void TrainLoop::add_checked_rays(std::vector<CheckedRay>& rays, const Log& log,
                                 const TrainingFrameData& frame, const SampledBatch& batch) {
    constexpr float kMinSolidWeight = 0.9f;  // minimum blending weight of a ray that hits a solid surface
    const Frame& sweep = log.frames[std::size_t(frame.position)];
    const Scan& scan = sweep.scan;
    const BodyTable& own_body = log.lidar_of(sweep).own_body;
    const RayDropTable& observed = frames_.mask_rules().observed_drops;
    renderer_.record_forward(batch.rays);
    stream_.submit_and_wait();
    const RenderedRayValues rendered =
        to_ray_values(renderer_.last_batch().rendered->download(batch.rays.n_rays));
    for (std::uint32_t j = 0; j < batch.rays.n_rays; ++j) {
        const std::size_t ray = batch.frame_ray(j);
        const glm::vec3& direction = scan.rays.direction[ray];
        const auto beam = log.find_global_beam(sweep.lidar, scan.rays.channel[ray]);
        if (!beam || own_body.hides(direction, scan.range_m[ray])) continue;
        const float drop_logit = rendered.drop_logit[j] - rendered.hit_logit[j];
        // Training ignored blind rays, so only the edges of surfaces may reach there.
        const bool is_ignored = is_blind_ray(observed, log, sweep, ray);
        const bool is_solid = rendered.weight[j] > kMinSolidWeight;
        if (!is_solid && !is_ignored) continue;
        rays.push_back({.bin = std::uint32_t(observed.index_of(*beam, direction)),
                        .is_dropped = !(scan.range_m[ray] > 0.0f),
                        .is_ignored = is_ignored,
                        .is_met = is_solid || drop_logit < 0.0f,
                        .range_m = rendered.depth[j] / rendered.weight[j],
                        .intensity = rendered.intensity[j],
                        .drop_logit = drop_logit});
    }
}

}  // namespace relidar
