// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network (paper, section 3.5) with the nominal rays of the sensor.
// Measured rays have jitter only if they have a return, which would reveal the answer.

#include <fmt/format.h>
#include <algorithm>
#include <array>
#include <functional>
#include <map>
#include <numeric>
#include <optional>

#include <relidar/diff/network.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "base/fail.hpp"
#include "base/sigmoid.hpp"
#include "train/checkpoints/checkpoint_keeper.hpp"
#include "train/drops/stripes.hpp"
#include "train/frames/frame_data.hpp"

namespace relidar {
namespace {

/// Returns true if a setting changes the rendered images or the network.
bool affects_network(const std::string& setting_key) {
    constexpr std::array kNetworkPrefixes{"refine.", "image.",       "sensor.",
                                          "init.",   "render.range", "train.seed"};
    return setting_key != "refine.enabled" && std::ranges::any_of(kNetworkPrefixes, [&](const char* group) {
               return setting_key.starts_with(group);
           });
}

/// Returns hashes of the log and the scene, which a resumed training compares.
std::vector<ResumeFingerprint> fingerprint_run(const Run& run) {
    std::vector<ResumeFingerprint> fingerprints = fingerprint_log(run.log, run.split);
    fingerprints.push_back(fingerprint_scene(run.scene));
    return fingerprints;
}

std::vector<ConfigKey> list_network_settings(const Config& config) {
    std::vector<ConfigKey> settings = list_config_keys(config);
    std::erase_if(settings, [](const ConfigKey& key) { return !affects_network(key.key); });
    return settings;
}

constexpr double kActorLogitSigma = 0.5;  // expected size of the offsets that are fitted to actors

bool uses_grid_rays(const Config& config) {
    return config.refine.image == "grid" && config.sensor.grid != "native";
}

/// Returns the rays along which a frame is rendered to train the network. If the network
/// corrects range images (refine.image is "grid"), these are the rays of the cells,
/// otherwise the rays of the LiDAR.
SimulatedSensor choose_sensor(const Config& config, const Log& log, const Frame& frame) {
    if (!uses_grid_rays(config)) return nominal_sensor(config, log, frame);
    SimulatedSensor sensor = make_sensor(config, log, frame.lidar);
    // the network learns from the scans of the log
    sensor.rolling_shutter = log.rolling_shutter;
    return sensor;
}

/// Rotates the rays towards the next column by a fraction of the column spacing. The
/// scene fits the original rays unusually well, because it was trained with them. Images
/// along rotated rays are as accurate as images of held-out frames.
RayTable rotate_rays(RayTable rays, float column_fraction) {
    const RayTable original = rays;
    const auto n_columns = std::size_t(original.columns);
    // Without a full turn, the last column has no next column and is not rotated.
    const bool circular = is_full_turn(rays.rows, rays.columns, original.direction);
    for (std::size_t i = 0; i < original.size(); ++i) {
        const std::size_t row = i / n_columns, next_column = (i + 1) % n_columns;
        if (!circular && next_column == 0) continue;
        const glm::vec3& next_direction = original.direction[row * n_columns + next_column];
        rays.direction[i] = glm::normalize(glm::mix(original.direction[i], next_direction, column_fraction));
    }
    return rays;
}

/// Returns the state of each cell of the range image: 0 returned, 1 dropped, -1 unknown
/// because it has a ray that the network must not learn, for example to a moving object.
/// @param drops  [rays] from classify_drops(); -1 for such a ray
std::vector<float> drops_to_grid(const Config& config, const Frame& frame, const std::vector<float>& drops) {
    std::vector<float> cells = measured_image(config, frame.scan).drop_prob;
    const RangeImageGrid grid = find_grid(config.sensor.grid);
    for (std::size_t ray = 0; ray < drops.size(); ++ray) {
        const bool is_learned = drops[ray] >= 0.0f, has_return = frame.scan.range_m[ray] > 0.0f;
        if (is_learned) continue;
        const glm::vec3 point_m = has_return ? frame.scan.return_point(ray) : frame.scan.rays.direction[ray];
        const std::optional<int> cell = project_to_pixel(grid, glm::dvec3(point_m));
        if (cell) cells[std::size_t(*cell)] = -1.0f;
    }
    return cells;
}

/// Returns the training frames that the network can read as images. These are all frames
/// if refine.image is "grid". Otherwise they are the frames with the most common number
/// of rows and columns, because the images must have the same shape.
std::vector<int> select_frames(const Config& config, const Log& log, const std::vector<int>& train_frames) {
    if (uses_grid_rays(config)) return train_frames;
    std::map<std::pair<int, int>, std::vector<int>> frames_by_shape;  // key: rows and columns
    for (const int position : train_frames) {
        const RayTable& rays = log.frames[std::size_t(position)].scan.rays;
        if (rays.rows > 1) frames_by_shape[{rays.rows, rays.columns}].push_back(position);
    }
    std::vector<int> most_frames;
    for (const auto& [shape, frames] : frames_by_shape)
        if (frames.size() > most_frames.size()) most_frames = frames;
    return most_frames;
}

/// A pixel of a training image whose ray hits an actor and whose drop is known.
struct ActorPixel {
    std::size_t image, pixel;
    std::uint16_t beam;  ///< among the beams of all LiDARs
};

/// Input images of the network with the measured drops, and their pixels on actors.
struct TrainingImages {
    std::vector<RayDropImage> images;
    std::vector<ActorPixel> actor_pixels;

    /// Adds the pixels of the last image, which was made of `scan`.
    void add_actor_pixels(const Log& log, int lidar, const RenderedScan& scan) {
        for (std::size_t i = 0; i < scan.instance.size(); ++i) {
            const auto beam = log.find_global_beam(lidar, scan.ring[i]);
            if (scan.instance[i] > 0 && beam && images.back().dropped[i] >= 0.0f)
                actor_pixels.push_back({.image = images.size() - 1, .pixel = i, .beam = *beam});
        }
    }
};

/// Returns the drops that the network learns, [pixels]: 0 returned, 1 dropped, -1 unused.
std::vector<float> learned_drops(const Run& run, const Config& config, const Frame& frame,
                                 const IgnoredMeasurements& masks) {
    std::vector<float> dropped = classify_drops(run.log, frame, masks);
    return uses_grid_rays(config) ? drops_to_grid(config, frame, dropped) : dropped;
}

/// Renders a training frame as input of the network, and adds it with its measured drops,
/// the values of its pixels that the network learns (-1: not learned), to `training`.
void add_image(TrainingImages& training, ScanRenderer& renderer, const Run& run, const Config& config,
               const Frame& frame, const IgnoredMeasurements& masks) {
    SimulatedSensor sensor = choose_sensor(config, run.log, frame);
    // A stripe is some neighbouring columns. A network of single pixels needs no
    // neighbours, so some stripes of each image suffice.
    const bool uses_stripes = config.refine.network == "pixel" && !sensor.grid;
    const int stripe_interval = uses_stripes ? choose_interval(sensor.rays) : 1;  // 1: the full image
    const ImageStripes stripes(stripe_interval, sensor.rays, training.images.size());
    // Rotated by half a column, so that no ray is one that trained the scene.
    sensor.rays = stripes.stripe_rays(rotate_rays(std::move(sensor.rays), 0.5f));
    const RenderedScan scan = renderer.render(sensor, frame.time_s);
    RayDropImage& image = training.images.emplace_back(
        make_drop_image(scan, channel_names(config.refine), first_position(run.log)));
    image.dropped = stripes.stripe_values(learned_drops(run, config, frame, masks));
    // The output of the network does not change rays that the scene always drops.
    for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
        if (scan.image.drop_prob[i] == 1.0f) image.dropped[i] = -1.0f;
    // A ray of a grid belongs to no beam, so it cannot help to fit the offsets of beams.
    if (!uses_grid_rays(config)) training.add_actor_pixels(run.log, frame.lidar, scan);
}

/// Renders the training images of the network. Returns no image if the user stopped.
TrainingImages render_images(Device& device, const Run& run, const Config& config,
                             const RayDropTrainingSession& session) {
    const std::vector<int> positions =
        select_evenly(select_frames(run.config, run.log, run.split.train), run.config.refine.frames);
    if (positions.empty())
        fail(
            "cannot train the ray-drop network of {}: no training frame has its rays in rows and columns, "
            "which the network needs",
            run.log.name);
    ScanRenderer renderer(device, run.scene, config, run.log);
    const IgnoredMeasurements masks = mask_movers(config, run.scene);
    if (properties_of(config.image.primitive).has_normals) renderer.add_channels("incidence");  // an input
    TrainingImages result;
    for (const int position : positions) {
        if (session.progress)
            session.progress("rendering training frames",
                             double(result.images.size()) / double(positions.size()));
        const Frame& frame = run.log.frames[std::size_t(position)];
        add_image(result, renderer, run, config, frame, masks);
        if (session.stop && session.stop()) return {};
    }
    if (session.progress) session.progress("rendering training frames", 1.0);
    return result;
}

/// Estimates RayDropNetwork::actor_logits, an offset b for each beam, from the measured
/// drops of rays that hit actors. Adds the offsets to the rendered logits of these rays:
///   P(ray is dropped) = sigmoid(rendered logit + s + b[beam])
/// Here, s is an error that all beams share. Newton's method maximises
///   log P(measured drops) - sum of b^2 / (2 kActorLogitSigma^2)
/// Discards s, because the network itself corrects it, on all surfaces.
std::vector<float> fit_actor_logits(TrainingImages& training, const std::vector<std::string>& inputs,
                                    std::size_t n_beams) {
    constexpr int kNewtonSteps = 40;
    constexpr double kMaxStep = 0.5;  // a longer step could overshoot where the curvature is small
    constexpr double kPrecision = 1.0 / (kActorLogitSigma * kActorLogitSigma);
    const auto channel = std::size_t(std::ranges::find(inputs, std::string("drop_logit")) - inputs.begin());
    const auto rendered_logit = [&](const ActorPixel& sample) -> float& {
        RayDropImage& image = training.images[sample.image];
        const std::size_t n_pixels = image.dropped.size();
        return image.channels[channel * n_pixels + sample.pixel];
    };
    double shared = 0.0;                        // s in the equation above
    std::vector<double> offsets(n_beams, 0.0);  // b
    for (int step = 0; step < kNewtonSteps; ++step) {
        // First and negative second derivative of log P by the offset of each beam. Their
        // sums are the derivatives by the shared error.
        std::vector<double> slope(n_beams), curvature(n_beams);
        for (const ActorPixel& sample : training.actor_pixels) {
            const double p_drop = sigmoid(double(rendered_logit(sample)) + shared + offsets[sample.beam]);
            slope[sample.beam] += double(training.images[sample.image].dropped[sample.pixel]) - p_drop;
            curvature[sample.beam] += p_drop * (1.0 - p_drop);
        }
        // Even steps move the shared error, odd steps the offsets: both change slopes.
        if (step % 2 == 0) {
            const double slope_sum = std::accumulate(slope.begin(), slope.end(), 0.0);
            // The 1e-9 avoids a division by 0.
            const double curvature_sum = std::accumulate(curvature.begin(), curvature.end(), 1e-9);
            shared += std::clamp(slope_sum / curvature_sum, -kMaxStep, kMaxStep);
            continue;
        }
        for (std::size_t beam = 0; beam < n_beams; ++beam)
            offsets[beam] +=
                std::clamp((slope[beam] - kPrecision * offsets[beam]) / (curvature[beam] + kPrecision),
                           -kMaxStep, kMaxStep);
    }
    const std::vector<float> result(offsets.begin(), offsets.end());
    for (const ActorPixel& sample : training.actor_pixels) rendered_logit(sample) += result[sample.beam];
    return result;
}

/// @throws DataError if the checkpoint is not from the training of a network
RayDropTrainState read_drop_state(const Checkpoint& checkpoint) {
    RayDropTrainState state;
    state.visit_state(CheckpointReader(checkpoint));
    return state;
}

}  // namespace

void check_drop_resume(const Checkpoint& checkpoint, const Run& run) {
    const std::string doing =
        fmt::format("cannot resume the ray-drop network from step {}", checkpoint.iteration);
    check_settings(list_network_settings(run.config), checkpoint, doing);
    check_fingerprints(fingerprint_run(run), checkpoint, doing);
    read_drop_state(checkpoint);  // throws an error if the state is incomplete
}

void read_drop_settings(const Checkpoint& checkpoint, Config& config) {
    for (const auto& [key, value] : read_settings(checkpoint)) set_value(config, key, value);
}

RayDropNetwork train_drops(Device& device, const Run& run, const RayDropTrainingSession& session) {
    if (session.start) check_drop_resume(*session.start, run);
    Config config = run.config;
    // The network learns the drops of single rays.
    config.sensor.sub_rays = config.sensor.returns = 1;
    begin_stage(session.stages, "network's images");
    TrainingImages training = render_images(device, run, config, session);
    begin_stage(session.stages, "network");
    const std::vector<RayDropImage>& images = training.images;
    if (images.empty()) return {};  // the user stopped
    // Offsets of beams improve the rendered logits, which most networks correct. The
    // network of the paper predicts drops, not corrections, so it gets no offsets.
    const std::vector<float> actor_logits =
        config.refine.network == "paper" || training.actor_pixels.empty()
            ? std::vector<float>{}
            : fit_actor_logits(training, channel_names(config.refine), run.log.count_beams());
    CheckpointFolder checkpoints({
        .folder = session.checkpoints,
        .newest_iteration = session.start ? session.start->iteration : 0,
        .iteration_noun = "ray-drop training step",
        .minutes = run.config.train.checkpoint_minutes,
        .report_note = session.note,
        .make_texts =
            [&run] { return make_resume_texts(list_network_settings(run.config), fingerprint_run(run)); },
    });
    std::optional<RayDropTrainState> start_state;  // empty: training does not resume
    if (session.start) start_state = read_drop_state(*session.start);
    bool stopped = false;
    // Called after each step. Saves a checkpoint after each epoch, after some minutes,
    // and if the user stops. Training stops if it returns false.
    const auto after_step = [&](const RayDropTrainProgress& progress,
                                const std::function<RayDropTrainState()>& download_state) {
        if (session.step) session.step(progress);
        stopped = session.stop && session.stop();
        const int steps_per_epoch = progress.n_steps / progress.n_epochs;
        const bool ends_epoch = progress.step % steps_per_epoch == 0;
        if (checkpoints.is_enabled() && (ends_epoch || checkpoints.is_time_due() || stopped))
            checkpoints.save(progress.step, [&](Checkpoint& checkpoint) {
                download_state().visit_state(CheckpointWriter(checkpoint));
            });
        return !stopped;
    };
    RayDropNetwork network = train_drop_network(device, images, config.refine, config.train.seed, after_step,
                                                start_state ? &*start_state : nullptr);
    if (uses_grid_rays(config)) network.image = config.sensor.grid;
    network.actor_logits = actor_logits;
    return stopped ? RayDropNetwork{} : network;
}

}  // namespace relidar
