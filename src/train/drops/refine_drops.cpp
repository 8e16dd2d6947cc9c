// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network, which is the last stage of training (paper, section 3.5).
// Renders training frames once, and trains the network to predict which rays the sensor
// dropped. The images use the nominal rays of the sensor. In a measured scan, only rays
// with a return have jitter. The jitter would reveal to the network which rays returned.
#include <algorithm>
#include <map>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "train/drops/refine_keeper.hpp"
#include "train/drops/stripes.hpp"
#include "train/frames/measured_frame.hpp"

namespace relidar {
namespace {

bool uses_grid(const Config& config) {
    return config.refine.image == "grid" && config.sensor.grid != "native";
}

/// Returns the rays of a frame's LiDAR. If the network corrects grid images (refine.image
/// = grid), returns one ray for each grid cell.
SensorChoice make_training_sensor(const Config& config, const Sequence& sequence, const Frame& frame) {
    if (!uses_grid(config)) return make_nominal_rays_of_frame(config, sequence, frame);
    SensorChoice sensor = make_configured_sensor(config, sequence, frame.lidar);
    // uses the rolling shutter of the log, because the network learns from the scans of
    // the log
    sensor.rolling_shutter = sequence.rolling_shutter;
    return sensor;
}

/// Rotates the rays towards the next column by a fraction of the column spacing. The
/// scene fits the original rays unusually well, because it was trained with them. Images
/// along the rotated rays are as accurate as images of frames that were not used for
/// training.
RayTable rotate_rays_by_column_fraction(RayTable rays, float share) {
    const RayTable original = rays;
    // Minimum cosine of the angle between neighbouring columns. It excludes the pair of
    // last and first column if the field of view is not a full turn.
    constexpr float kNear = 0.9f;
    for (std::size_t i = 0; i < original.size(); ++i) {
        const std::size_t row = i / std::size_t(original.columns),
                          next = (i + 1) % std::size_t(original.columns);
        const glm::vec3& towards =
            original.direction[row * std::size_t(original.columns) + next % std::size_t(original.columns)];
        if (glm::dot(original.direction[i], towards) > kNear)
            rays.direction[i] = glm::normalize(glm::mix(original.direction[i], towards, share));
    }
    return rays;
}

/// Converts the measured drops of rays to drops of the grid cells: 0 returned, 1 dropped,
/// -1 unknown. A cell is unknown if one of its returns is unknown.
std::vector<float> compute_grid_drops(const Config& config, const Frame& frame,
                                      const std::vector<float>& dropped) {
    std::vector<float> cells = make_real_image(config, frame.scan).drop_prob;
    const RangeGrid grid = find_grid(config.sensor.grid);
    for (std::size_t i = 0; i < dropped.size(); ++i) {
        if (dropped[i] >= 0.0f || !(frame.scan.range_m[i] > 0.0f)) continue;
        if (const std::optional<int> cell = project(grid, glm::dvec3(frame.scan.point(i))))
            cells[std::size_t(*cell)] = -1.0f;
    }
    return cells;
}

/// Returns the training frames whose rays form an image with rows and columns. If the
/// images have different sizes, returns only the frames with the most frequent size.
std::vector<int> make_images_of_frames(const Config& config, const Sequence& sequence,
                                       const std::vector<int>& train) {
    if (uses_grid(config)) return train;
    std::map<std::pair<int, int>, std::vector<int>> by_shape;
    for (const int position : train) {
        const RayTable& rays = sequence.frames[std::size_t(position)].scan.rays;
        if (rays.rows > 1) by_shape[{rays.rows, rays.columns}].push_back(position);
    }
    const auto most = std::max_element(
        by_shape.begin(), by_shape.end(),
        [](const auto& first, const auto& second) { return first.second.size() < second.second.size(); });
    return most == by_shape.end() ? std::vector<int>{} : most->second;
}

/// Renders training frames. Returns the rendered inputs of the ray-drop network together
/// with the measured drops. Returns nothing if the user stopped the program.
std::vector<DropImage> make_training_images(Device& device, const Run& run, const Config& config,
                                            const RefineSession& session) {
    const std::vector<int> positions = select_evenly_spaced(
        make_images_of_frames(run.config, run.sequence, run.split.train), run.config.refine.frames);
    if (positions.empty())
        throw DataError(
            fmt::format("cannot train the ray-drop network of {}: no training frame has its rays in rows and "
                        "columns, which the network needs",
                        run.sequence.name));
    ScanRenderer renderer(device, run.scene, config, run.sequence);
    const Unknown masks = make_masks(config, run.scene);
    const std::vector<std::string> channels = list_drop_channels(config.refine);
    if (get_primitive_kind(config.image.primitive).has_normals) renderer.enable_channels("incidence");
    std::vector<DropImage> images;
    for (const int position : positions) {
        if (session.progress)
            session.progress("rendering training frames", double(images.size()) / double(positions.size()));
        const Frame& frame = run.sequence.frames[std::size_t(position)];
        SensorChoice sensor = make_training_sensor(config, run.sequence, frame);
        const bool parted = config.refine.network == "pixel" && !sensor.grid;
        const Stripes stripes(parted ? compute_stripe_share(sensor.rays) : 1, sensor.rays, images.size());
        sensor.rays = stripes.rays(rotate_rays_by_column_fraction(std::move(sensor.rays), 0.5f));
        const RenderedScan scan = renderer.render(sensor, frame.time_s);
        images.push_back(make_drop_image(scan, channels, get_first_origin(run.sequence)));
        std::vector<float> dropped = find_measured_drops(run.sequence, frame, masks);
        if (uses_grid(config)) dropped = compute_grid_drops(config, frame, dropped);
        images.back().dropped = stripes.values(dropped);
        for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
            // Excludes rays that always drop, because the output of the network does not
            // change them.
            if (scan.image.drop_prob[i] == 1.0f) images.back().dropped[i] = -1.0f;
        if (session.stop && session.stop()) return {};
    }
    if (session.progress) session.progress("rendering training frames", 1.0);
    return images;
}

}  // namespace

DropNetwork refine_drops(Device& device, const Run& run, const RefineSession& session) {
    if (session.start) check_refine_resumable(*session.start, run);
    Config config = run.config;
    config.sensor.sub_rays = config.sensor.returns = 1;
    begin_stage(session.stages, "network's images");
    const std::vector<DropImage> images = make_training_images(device, run, config, session);
    begin_stage(session.stages, "network");
    if (images.empty()) return {};
    RefineKeeper checkpoints(run, session);
    const std::optional<RefineState> start =
        session.start ? std::optional(read_refine_state(*session.start)) : std::nullopt;
    bool stopped = false;
    const auto after_step = [&](const RefineProgress& progress, const std::function<RefineState()>& state) {
        if (session.step) session.step(progress);
        stopped = session.stop && session.stop();
        checkpoints.after_step(progress, stopped, state);
        return !stopped;
    };
    DropNetwork network = train_drop_network(device, images, config.refine, config.train.seed, after_step,
                                             start ? &*start : nullptr);
    if (uses_grid(config)) network.image = config.sensor.grid;
    return stopped ? DropNetwork{} : network;
}

}  // namespace relidar
