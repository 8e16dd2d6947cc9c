// SPDX-License-Identifier: Apache-2.0
// Runs a training iteration (docs/method.md sections 4-6). The host submits each
// iteration to the GPU without waiting, and reads the losses a few iterations later
// (readback_lag.hpp).
#include "train/train_loop.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include <relidar/gpu/out_of_memory.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>

#include "base/fail.hpp"
#include "train/readback_lag.hpp"

namespace relidar {

FrameSampler::FrameSampler(std::size_t count, std::uint64_t seed) : order_(count), random_(seed) {
    std::iota(order_.begin(), order_.end(), std::uint64_t(0));
}

std::size_t FrameSampler::sample_next_frame_index() {
    if (position_ == 0)
        for (std::size_t i = order_.size(); i > 1; --i)
            std::swap(order_[i - 1], order_[random_.sample_random_uint64() % i]);
    const std::size_t frame = order_[position_];
    position_ = (position_ + 1) % order_.size();
    return frame;
}

std::optional<std::size_t> FrameSampler::peek_next_frame_index() const {
    return position_ == 0 ? std::nullopt : std::optional(std::size_t(order_[position_]));
}

namespace {

/// Relative to the rate of the constant coefficient. A twentieth, as in 3D Gaussian
/// splatting, because few views observe how the intensity depends on the direction.
constexpr double kShRestFactor = 0.05;

// Number of iterations between two measurements of the traversal cost of the tree. If the
// cost has grown too much, the tree is rebuilt.
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

/// Proportional to the extent of the model. Steps suitable for a street would move an
/// actor's surfels out of its box.
/// @return [models] factors
std::vector<float> compute_position_learning_rate_factors(const Scene& scene_layout,
                                                          double background_extent_m) {
    std::vector<float> factors;
    for (const SurfelModel& model : scene_layout.models)
        factors.push_back(
            model.half_size_m.x > 0.0f
                ? static_cast<float>(compute_actor_model_extent_m(model.half_size_m) / background_extent_m)
                : 1.0f);
    return factors;
}

int get_active_sh_degree(const TrainConfig& config, int step) {
    return config.sh_degree_start + std::max(step - 1, 0) / std::max(1, config.sh_degree_interval);
}

/// A margin around the surfels' boxes prevents missed hits between two refits of the
/// tree.
struct TreeRefitSchedule {
    int every = 1;  ///< iterations between two refits
    AccelOptions accel;
};

/// In one iteration, a surfel moves by millimetres and grows by a few per cent. If most
/// surfels are fixed, refits would take most of the time. If spherical harmonics are
/// evaluated per ray, only a refit updates the surfel records.
TreeRefitSchedule choose_tree_refit_options(const Config& config, std::uint32_t n_fixed_surfels) {
    if (config.image.sh_direction == ShDirection::ray) return {};
    if (n_fixed_surfels > 0) return {4, {.margin_scale = 1.1f, .margin_m = 0.01f}};
    return {2, {.margin_scale = 1.05f, .margin_m = 0.003f}};
}

/// Every step is due while the learning rate is so high that surfels could outgrow the
/// margin.
bool should_refit_tree(const TreeRefitSchedule& refit_options, const TrainConfig& config, int step) {
    // Share of the margin for a growing scale. The remainder is for a growing opacity,
    // because a more opaque surfel also needs a larger box.
    constexpr double kShare = 0.9;
    const double growth = (refit_options.every - 1) * compute_learning_rates(config, 1.0, step).log_scale;
    return growth > kShare * std::log(refit_options.accel.margin_scale) ||
           (step - 1) % refit_options.every == 0;
}

/// Proportional to the initial scale: surfels close to each other start small, surfels
/// far apart must be able to fill the gaps.
std::vector<float> compute_max_log_scales(const Surfels& surfels, double max_growth_factor) {
    std::vector<float> bounds;
    for (std::size_t i = 0; i < surfels.size(); ++i) {
        float largest = std::max(surfels.log_scale[i].x, surfels.log_scale[i].y);
        if (get_primitive_properties(surfels.primitive).third_scale)
            largest = std::max(largest, surfels.log_scale_w[i]);
        bounds.push_back(largest + static_cast<float>(std::log(max_growth_factor)));
    }
    return bounds;
}

/// The box loss gives every surfel a gradient, even if no ray hits it.
bool does_every_surfel_get_gradient(const Config& config) {
    return config.loss.box > 0.0f && !config.train.only_touched;
}

IgnoredMeasurements make_training_mask_rules(const LidarSequence& sequence, const TrainTestSplit& split,
                                             const Scene& scene, const Config& config) {
    IgnoredMeasurements masks{
        config.init,
        {},
        config.train.sensor_drop ? estimate_observed_drop_rates(sequence, split.train) : RayDropTable{}};
    for (const ModelInstance& instance : scene.instances)
        if (!instance.track.empty()) masks.actors.push_back(instance.track);
    return masks;
}

/// Nothing if training uses the rays of the sensor.
/// @throws UsageError if another setting requires the rays of the sensor
std::optional<RangeImageGrid> find_training_range_grid(const Config& config) {
    if (config.train.grid == "native") return std::nullopt;
    const std::pair<bool, const char*> needs_sensor_rays[] = {
        {config.train.sensor_drop, "train.sensor_drop"}, {config.blocks.length_m > 0.0, "blocks.length_m"}};
    for (const auto& [is_set, setting] : needs_sensor_rays)
        if (is_set)
            fail<UsageError>(
                "the setting train.grid={} cannot be combined with {}, which needs the rays of the sensor "
                "(train.grid=native)",
                config.train.grid, setting);
    return get_range_image_grid_by_name(config.train.grid);
}

}  // namespace

TrainLoop::TrainLoop(Device& device, const LidarSequence& sequence, const TrainTestSplit& split,
                     const Scene& initial, const Config& config, std::uint32_t n_fixed_surfels,
                     std::optional<double> extent_m)
    : config_(config),
      n_fixed_(n_fixed_surfels),
      frames_(device, sequence, split.train,
              {.unknown = make_training_mask_rules(sequence, split, initial, config),
               .moves_rays = config.train.is_pose_refinement_enabled_for("sensor"),
               .resident_bytes = std::uint64_t(config.train.frame_memory_mib) << 20,
               .grid = find_training_range_grid(config)}),
      batches_(device, config, frames_.get_all_frames()),
      refiner_(device, sequence, initial, config.train, frames_),
      differentiable_(device, initial, config.image,
                      {.accel = choose_tree_refit_options(config, n_fixed_surfels).accel,
                       .trace = make_training_trace_options(config),
                       .n_rays = find_max_rays_per_frame(frames_.get_all_frames()),
                       .keep_hits = static_cast<std::uint32_t>(config.trace.keep_hits)},
                      {make_backward_options(config), refiner_.get_required_gradients(),
                       does_every_surfel_get_gradient(config)}),
      renderer_(differentiable_.renderer()),
      stream_(renderer_.stream()),
      losses_(make_losses(device, config.loss, find_max_rays_per_frame(frames_.get_all_frames()))),
      adam_(device, get_surfel_count(),
            {.only_touched = config.train.only_touched, .n_fixed = n_fixed_surfels},
            initial.surfels.get_parameter_set()),
      densifier_(device, initial, config.densify, config.image.alpha_min,
                 static_cast<std::uint32_t>(frames_.get_all_frames().size()), config.train.seed),
      reports_(device),
      extent_m_(extent_m ? *extent_m : compute_robust_background_extent_m(initial)),
      sampler_(frames_.get_all_frames().size(), config.train.seed) {
    for (std::size_t i = 0; i < frames_.get_all_frames().size(); ++i)
        frames_[i].placed = compute_instance_poses(
            initial, sequence, get_sweep_timing_of_frame(sequence.frames[std::size_t(frames_[i].position)]));
    // Densification splits large surfels, so it needs no limit.
    if (config.densify.strategy == DensifyStrategy::none)
        adam_.set_max_log_scale_of_each_surfel(
            device, compute_max_log_scales(initial.surfels, config.train.max_growth));
}

TrainLoop::~TrainLoop() {
    try {
        // The device may still use the arrays if training ended with an exception.
        stream_.submit_and_wait();
    } catch (const Error&) {
        // Already reported. A lost device no longer uses the arrays.
    }
}

const TrainingFrameData& TrainLoop::upload_frame_and_move_instances(std::size_t frame_index,
                                                                    bool surfels_changed) {
    TrainingFrameData& frame = frames_.upload_frame_if_not_resident(stream_, frame_index);
    refiner_.move_frame_to_corrected_poses(stream_, frame);
    if (surfels_changed) renderer_.record_scene_update_for_view(frame.placed, frame.sensor_position_m);
    else renderer_.record_instance_poses_and_view(frame.placed, frame.sensor_position_m);
    return frame;
}

void TrainLoop::record_render_and_backward(const RayBatch& rays, const TargetBatch& targets,
                                           const LossTermRow& loss_terms) {
    renderer_.record_forward_pass(rays);  // renders the batch (equations 2-4)
    // Computes the losses (equations 10-11).
    for (const std::unique_ptr<Loss>& loss : losses_)
        loss->record_ray_losses(stream_, differentiable_.get_last_rendered_batch(), targets, loss_terms);
    differentiable_.record_backward_pass();  // computes the gradients (equation 9)
}

void TrainLoop::run_iteration(int step, bool is_last_of_log_interval) {
    check_iteration_reports_until(step - kReadbackLag);
    refiner_.apply_pose_updates_until(stream_, step - kReadbackLag);
    const std::size_t frame_index = sampler_.sample_next_frame_index();
    DeviceScene& scene = renderer_.scene();

    renderer_.set_sh_degree(get_active_sh_degree(config_.train, step));
    const TrainingFrameData& frame = upload_frame_and_move_instances(
        frame_index, should_refit_tree(choose_tree_refit_options(config_, n_fixed_), config_.train, step));
    if (const std::optional<std::size_t> next_frame_index = sampler_.peek_next_frame_index())
        frames_.prefetch_frame(*next_frame_index);
    const SampledBatch batch = batches_.sample_random_batch(stream_, frame, sampler_.get_random_generator());
    const LossTermRow terms = reports_.get_current_loss_row();
    record_render_and_backward(batch.rays, batch.targets, terms);
    DeviceGradients& gradients = differentiable_.gradients();
    refiner_.record_pose_gradients(stream_, frame_index, frame, batch, gradients, step);
    for (const std::unique_ptr<Loss>& loss : losses_)
        loss->record_regularisation_losses(
            stream_, scene, {&gradients.surfels, config_.train.only_touched ? &gradients.touched : nullptr},
            terms);
    const bool is_full_frame = batch.rays.n_rays == frame.n_rays;
    densifier_.record_gradient_statistics_update(
        stream_, scene,
        {&gradients.surfels, &gradients.touched, static_cast<std::uint32_t>(frame_index), is_full_frame});
    LearningRates rates = compute_learning_rates(config_.train, extent_m_, step);
    if (config_.densify.strategy == DensifyStrategy::adaptive) {
        rates.models = &scene.get_model_table();
        rates.mean_factors = compute_position_learning_rate_factors(scene.get_scene_layout(), extent_m_);
    }
    const Array<std::uint32_t, shared::TouchedSurfels>* touched =
        does_every_surfel_get_gradient(config_) ? nullptr : &gradients.touched;
    adam_.record_adam_step(stream_, scene.get_surfel_parameters(), gradients.surfels, touched, rates, step,
                           renderer_.model().sh_degree);
    reports_.add_iteration_to_next_report(step, frame.index);
    if (densifier_.should_densify_after_step(step))
        differentiable_.change_surfels_and_reallocate_memory([&](double other_allocation_bytes) {
            densified_.add_counts(
                densifier_.densify_surfels(stream_, scene, adam_, step, other_allocation_bytes));
        });
    densifier_.record_opacity_reset_if_scheduled(stream_, scene, adam_, step);
    if (is_last_of_log_interval || reports_.is_loss_table_full())
        start_iteration_report_readback(step, is_last_of_log_interval);
    if (step % kGrowthEvery == 0) renderer_.accel().record_bvh_cost_measurement(stream_);
    submitted_ = stream_.submit_commands();
    last_step_ = step;
}

void TrainLoop::start_iteration_report_readback(int step, bool is_last_of_log_interval) {
    const BackwardPass& backward = differentiable_.backward_pass();
    const DeviceHitCounters counts{
        &renderer_.forward_pass().get_truncated_ray_count_on_device(),
        config_.train.deterministic ? backward.get_max_hit_count_on_device() : nullptr,
        backward.get_hit_capacity(), &renderer_.forward_pass().get_hit_overflow_ray_count_on_device(),
        renderer_.get_stored_hits_per_ray()};
    reports_.record_copy_of_report_to_host(
        stream_, counts,
        is_last_of_log_interval
            ? std::optional(TrainLogLine{step, {}, get_surfel_count(), std::exchange(densified_, {})})
            : std::nullopt);
}

void TrainLoop::check_iteration_reports_until(int last_step) {
    while (const std::optional<IterationReports::IterationGroupReport> report =
               reports_.take_oldest_report_until_step(stream_, last_step)) {
        if (report->pass_cap > 0)
            fail<DeviceError>(
                "training failed in iterations {} to {}: the search for surfels stopped {} times at its "
                "limit of passes or with a full stack; the scene probably has too many overlapping surfels",
                report->first_step, report->last_step, report->pass_cap);
        increase_hit_capacity_if_needed(*report);
        increase_stored_hits_per_ray_if_needed(*report);
    }
}

void TrainLoop::increase_hit_capacity_if_needed(const IterationReports::IterationGroupReport& report) {
    if (report.most_hits > report.hit_capacity)
        fail<DeviceError>(
            "training failed in iterations {} to {} with train.deterministic=true: one iteration has {} "
            "hits, expected at most {}; use fewer rays per iteration (train.rays_per_iteration)",
            report.first_step, report.last_step, report.most_hits, report.hit_capacity);
    if (report.most_hits <= differentiable_.backward_pass().get_hit_capacity() / 2) return;
    // A report has only one `hit_capacity`, so the steps so far get their own report.
    start_iteration_report_readback(last_step_, false);
    // twice the reported number, so that later steps can have more hits
    differentiable_.backward_pass().reserve_hit_memory(stream_, 2 * std::uint64_t(report.most_hits));
}

void TrainLoop::increase_stored_hits_per_ray_if_needed(const IterationReports::IterationGroupReport& report) {
    // The iterations of an older report ran before the last increase.
    if (report.stored_hits_per_ray != renderer_.get_stored_hits_per_ray() || hit_memory_exhausted_) return;
    const std::uint32_t n_hits = recommend_stored_hits_per_ray(report.stored_hits_per_ray, report.overfull);
    if (n_hits == report.stored_hits_per_ray) return;
    // A report has only one `stored_hits_per_ray`, so the steps so far get their own
    // report.
    start_iteration_report_readback(last_step_, false);
    try {
        renderer_.set_stored_hits_per_ray(n_hits);
    } catch (const OutOfDeviceMemory&) {
        hit_memory_exhausted_ = true;
    }
}

void TrainLoop::wait_for_iterations() {
    start_iteration_report_readback(last_step_, false);
    submitted_ = stream_.submit_commands();
    check_iteration_reports_until(last_step_);
    refiner_.wait_for_pending_gradients(stream_);
    stream_.wait_for_submission(submitted_);
}

void TrainLoop::complete_training() {
    wait_for_iterations();
    refiner_.apply_pose_updates_until(stream_, last_step_);
}

void TrainLoop::save_training_state_to_checkpoint(Checkpoint& checkpoint) {
    wait_for_iterations();
    checkpoint.texts["layout"] = format_scene_layout_json(renderer_.scene().get_scene_layout());
    visit_checkpoint_state(CheckpointWriter(checkpoint));
}

void TrainLoop::restore_training_state_from_checkpoint(const Checkpoint& checkpoint) {
    // pending iterations would overwrite the restored state
    wait_for_iterations();
    visit_checkpoint_state(CheckpointReader(checkpoint));
    last_step_ = checkpoint.iteration;
    refiner_.update_corrected_poses();
}

RayDropTable TrainLoop::estimate_sensor_drop_rates(Device& device, const LidarSequence& sequence) {
    // In a full log, one batch of each frame gives hundreds of rays per bin of the drop
    // table.
    constexpr std::uint32_t kRays = 20000;
    // Minimum. In a short log, several batches of each frame, or all of its rays, are
    // used.
    constexpr std::size_t kRaysPerBin = 20;
    Config some_rays = config_;
    some_rays.train.rays_per_iteration = kRays;
    // The image loss would restrict a batch to a window of columns, but all directions
    // are needed.
    some_rays.loss.intensity_ssim = 0.0f;
    BatchSampler batches(device, some_rays, frames_.get_all_frames());
    RayDropCounts counts(sequence);
    renderer_.set_sh_degree(get_active_sh_degree(config_.train, config_.train.iterations));
    const std::size_t rays_of_frame =
        kRaysPerBin * counts.get_bin_count() / std::max<std::size_t>(1, frames_.get_all_frames().size());
    for (std::size_t k = 0; k < frames_.get_all_frames().size(); ++k) {
        // The last iteration moved the surfels, so the first frame (k == 0) refits the
        // tree.
        const TrainingFrameData& frame = upload_frame_and_move_instances(k, k == 0);
        if (k + 1 < frames_.get_all_frames().size()) frames_.prefetch_frame(k + 1);
        const std::uint32_t first =
            batches.sample_random_first_column(frame, sampler_.get_random_generator());
        const auto passes = static_cast<std::uint32_t>(
            std::clamp<std::size_t>(rays_of_frame / kRays, 1, batches.count_batches_covering_frame(frame)));
        for (std::uint32_t pass = 0; pass < passes; ++pass)
            add_batch_to_drop_counts(counts, sequence, frame,
                                     batches.gather_nth_batch(stream_, frame, first, pass));
    }
    RayDropTable drops = counts.estimate_smoothed_drop_rates();
    mark_unobserved_sectors_as_dropped(drops, frames_.get_mask_rules().observed_drops, sequence);
    return drops;
}

void TrainLoop::add_batch_to_drop_counts(RayDropCounts& counts, const LidarSequence& sequence,
                                         const TrainingFrameData& frame, const SampledBatch& batch) {
    // Minimum blending weight of a ray that hits a solid surface. Other rays count only
    // in sectors that training ignores.
    constexpr float kSolid = 0.9f;
    const LidarFrame& sweep = sequence.frames[std::size_t(frame.position)];
    const RayDropTable& observed = frames_.get_mask_rules().observed_drops;
    renderer_.record_forward_pass(batch.rays);
    stream_.submit_and_wait();
    const RenderedRayValues r = convert_rays_to_rendered_values(
        renderer_.get_last_rendered_batch().rendered->download(batch.rays.n_rays));
    for (std::uint32_t j = 0; j < batch.rays.n_rays; ++j) {
        const std::size_t ray = batch.convert_batch_to_frame_ray_index(j);
        if (r.hit_logit[j] > r.drop_logit[j] &&
            (r.weight[j] > kSolid || is_ray_in_blind_sector(observed, sequence, sweep, ray)))
            counts.add_ray_to_drop_counts(sweep, ray);
    }
}

}  // namespace relidar
