// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/stage_options.hpp>

namespace relidar {

Config with_max_range(Config config, const Log& sequence) {
    if (config.dataset.max_range_m > 0.0) return config;
    for (const Lidar& lidar : sequence.lidars)
        config.dataset.max_range_m = std::max(config.dataset.max_range_m, lidar.sensor.max_range_m);
    return config;
}

TraceOptions common_options(const Config& config) {
    TraceOptions options;
    options.chunk = config.trace.chunk;
    return options;
}

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

}  // namespace relidar
