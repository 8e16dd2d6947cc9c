// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network (paper, section 3.5) with the nominal rays of the sensor.
// Measured rays have jitter only if they have a return, which would reveal the answer.

#include <fmt/format.h>
#include <algorithm>
#include <array>
#include <functional>
#include <map>
#include <optional>

#include <relidar/diff/network.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "base/fail.hpp"
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

std::vector<ResumeFingerprint> fingerprint_run(const Run& run) {
    std::vector<ResumeFingerprint> marks = fingerprint_log(run.sequence, run.split);
    marks.push_back(fingerprint_scene(run.scene));
    return marks;
}

std::vector<ConfigKey> list_network_settings(const Config& config) {
    std::vector<ConfigKey> settings = list_config_keys(config);
    std::erase_if(settings, [](const ConfigKey& key) { return !affects_network(key.key); });
    return settings;
}

bool uses_grid_rays(const Config& config) {
    return config.refine.image == "grid" && config.sensor.grid != "native";
}

/// Returns the rays along which a frame is rendered to train the network. If the network
/// corrects range images (refine.image is "grid"), these are the rays of the cells,
/// otherwise the rays of the LiDAR.
SimulatedSensor choose_sensor(const Config& config, const Log& sequence, const Frame& frame) {
    if (!uses_grid_rays(config)) return nominal_sensor(config, sequence, frame);
    SimulatedSensor sensor = make_sensor(config, sequence, frame.lidar);
    // the network learns from the scans of the log
    sensor.rolling_shutter = sequence.rolling_shutter;
    return sensor;
}

/// Rotates the rays towards the next column by a fraction of the column spacing. The
/// scene fits the original rays unusually well, because it was trained with them. Images
/// along rotated rays are as accurate as images of held-out frames.
RayTable rotate_rays(RayTable rays, float column_fraction) {
    const RayTable original = rays;
    // Without a full turn, the last column has no next column and is not rotated.
    const bool circular = is_full_turn(rays.rows, rays.columns, original.direction);
    for (std::size_t i = 0; i < original.size(); ++i) {
        const std::size_t row = i / std::size_t(original.columns),
                          next = (i + 1) % std::size_t(original.columns);
        const glm::vec3& towards =
            original.direction[row * std::size_t(original.columns) + next % std::size_t(original.columns)];
        if (circular || next % std::size_t(original.columns) != 0)
            rays.direction[i] = glm::normalize(glm::mix(original.direction[i], towards, column_fraction));
    }
    return rays;
}

/// Returns the state of each cell of the range image: 0 returned, 1 dropped, -1 unknown.
/// A cell is unknown if one of its returns belongs to a ray with a negative value in
/// `drops`.
std::vector<float> drops_to_grid(const Config& config, const Frame& frame, const std::vector<float>& drops) {
    std::vector<float> cells = measured_image(config, frame.scan).drop_prob;
    const RangeImageGrid grid = find_grid(config.sensor.grid);
    for (std::size_t i = 0; i < drops.size(); ++i) {
        if (drops[i] >= 0.0f || !(frame.scan.range_m[i] > 0.0f)) continue;
        if (const std::optional<int> cell = project_to_pixel(grid, glm::dvec3(frame.scan.return_point(i))))
            cells[std::size_t(*cell)] = -1.0f;
    }
    return cells;
}

/// Returns the training frames that the network can read as images. These are all frames
/// if refine.image is "grid". Otherwise they are the frames with the most common number
/// of rows and columns, because the images must have the same shape.
std::vector<int> select_frames(const Config& config, const Log& log, const std::vector<int>& train_frames) {
    if (uses_grid_rays(config)) return train_frames;
    std::map<std::pair<int, int>, std::vector<int>> by_shape;
    for (const int position : train_frames) {
        const RayTable& rays = log.frames[std::size_t(position)].scan.rays;
        if (rays.rows > 1) by_shape[{rays.rows, rays.columns}].push_back(position);
    }
    const auto most = std::max_element(
        by_shape.begin(), by_shape.end(),
        [](const auto& first, const auto& second) { return first.second.size() < second.second.size(); });
    return most == by_shape.end() ? std::vector<int>{} : most->second;
}

/// Renders the inputs of the network for training frames, and adds their measured drops.
/// Returns an empty list if the user stopped.
std::vector<RayDropImage> render_images(Device& device, const Run& run, const Config& config,
                                        const RayDropTrainingSession& session) {
    const std::vector<int> positions =
        select_evenly(select_frames(run.config, run.sequence, run.split.train), run.config.refine.frames);
    if (positions.empty())
        fail(
            "cannot train the ray-drop network of {}: no training frame has its rays in rows and columns, "
            "which the network needs",
            run.sequence.name);
    ScanRenderer renderer(device, run.scene, config, run.sequence);
    const IgnoredMeasurements masks = mask_movers(config, run.scene);
    const std::vector<std::string> channels = channel_names(config.refine);
    if (properties_of(config.image.primitive).has_normals) renderer.add_channels("incidence");
    std::vector<RayDropImage> images;
    for (const int position : positions) {
        if (session.progress)
            session.progress("rendering training frames", double(images.size()) / double(positions.size()));
        const Frame& frame = run.sequence.frames[std::size_t(position)];
        SimulatedSensor sensor = choose_sensor(config, run.sequence, frame);
        // A network of single pixels needs no neighbours, so stripes of each image
        // suffice.
        const bool parted = config.refine.network == "pixel" && !sensor.grid;
        const ImageStripes stripes(parted ? choose_interval(sensor.rays) : 1, sensor.rays, images.size());
        sensor.rays = stripes.stripe_rays(rotate_rays(std::move(sensor.rays), 0.5f));
        const RenderedScan scan = renderer.render(sensor, frame.time_s);
        images.push_back(make_drop_image(scan, channels, first_position(run.sequence)));
        std::vector<float> dropped = classify_drops(run.sequence, frame, masks);
        if (uses_grid_rays(config)) dropped = drops_to_grid(config, frame, dropped);
        images.back().dropped = stripes.stripe_values(dropped);
        for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
            // Excludes rays that the scene always drops, because the output of the
            // network does not change them.
            if (scan.image.drop_prob[i] == 1.0f) images.back().dropped[i] = -1.0f;
        if (session.stop && session.stop()) return {};
    }
    if (session.progress) session.progress("rendering training frames", 1.0);
    return images;
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
    check_same(list_network_settings(run.config), checkpoint, doing);
    for (const ResumeFingerprint& mark : fingerprint_run(run)) check_same(checkpoint, mark, doing);
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
    const std::vector<RayDropImage> images = render_images(device, run, config, session);
    begin_stage(session.stages, "network");
    if (images.empty()) return {};
    CheckpointFolder checkpoints(
        session.checkpoints, session.start ? session.start->iteration : 0, "ray-drop training step",
        run.config.train.checkpoint_minutes, session.note,
        [&run] { return make_resume_texts(list_network_settings(run.config), fingerprint_run(run)); });
    const std::optional<RayDropTrainState> start =
        session.start ? std::optional(read_drop_state(*session.start)) : std::nullopt;
    bool stopped = false;
    // Called after each step. Training stops if it returns false.
    const auto after_step = [&](const RayDropTrainProgress& progress,
                                const std::function<RayDropTrainState()>& state) {
        if (session.step) session.step(progress);
        stopped = session.stop && session.stop();
        const bool ends_epoch = progress.step % (progress.n_steps / progress.n_epochs) == 0;
        if (checkpoints.is_enabled() && (ends_epoch || checkpoints.is_time_due() || stopped))
            checkpoints.save(progress.step, [&](Checkpoint& checkpoint) {
                state().visit_state(CheckpointWriter(checkpoint));
            });
        return !stopped;
    };
    RayDropNetwork network = train_drop_network(device, images, config.refine, config.train.seed, after_step,
                                                start ? &*start : nullptr);
    if (uses_grid_rays(config)) network.image = config.sensor.grid;
    return stopped ? RayDropNetwork{} : network;
}

}  // namespace relidar
