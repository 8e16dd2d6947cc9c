// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/stage_options.hpp>

#include <cmath>

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>

#include "base/list_text.hpp"

namespace relidar {

Config with_max_range(Config config, const Log& log) {
    if (config.dataset.max_range_m > 0.0) return config;
    for (const Lidar& lidar : log.lidars)
        config.dataset.max_range_m = std::max(config.dataset.max_range_m, lidar.sensor.max_range_m);
    return config;
}

TraceOptions common_options(const Config& config) { return {.chunk = config.trace.chunk}; }

TraceOptions training_options(const Config& config) {
    TraceOptions options = common_options(config);
    if (config.loss.likelihood > 0.0f)
        options.likelihood = RangeLikelihoodKernel{config.loss.likelihood_scale_m};
    return options;
}

TraceOptions rendering_options(const Config& config) {
    TraceOptions options = common_options(config);
    // for output channels and ray-drop networks
    options.normals = properties_of(config.image.primitive).has_normals;
    if (config.render.range == "mode")
        options.mode_gap_m = static_cast<float>(config.sensor.return_separation_m);
    return options;
}

BackwardOptions backward_options(const Config& config) {
    BackwardOptions options;
    if (config.train.deterministic) options.reduction = GradientReduction::gather;
    return options;
}

Log load_log(const Config& config, const Progress& progress, int max_scans) {
    DatasetOptions options;
    options.sequence = config.dataset.sequence;
    options.lidars = split_list(config.dataset.lidars);
    options.frames = {config.dataset.frames_begin, config.dataset.frames_end};
    options.poses_file = config.dataset.poses;
    options.skip_broken = config.dataset.skip_broken;
    options.conventions = config.conventions;
    options.rolling_shutter = config.sensor.rolling_shutter != RollingShutter::no;
    // The setting 0 means no limit.
    options.max_range_m = config.dataset.max_range_m > 0.0 ? config.dataset.max_range_m : INFINITY;
    options.min_range_m = config.dataset.min_range_m;
    options.bag.poses_from = config.dataset.poses_from;
    options.waymo.clamp_intensity = config.dataset.waymo_intensity == "clamp";
    options.progress = progress;
    options.max_scans = max_scans;
    return load_log(config.dataset.path, options);
}

}  // namespace relidar
