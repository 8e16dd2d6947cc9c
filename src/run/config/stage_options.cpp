// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/stage_options.hpp>

namespace relidar {

Config replace_automatic_max_range(Config config, const LidarSequence& sequence) {
    if (config.dataset.max_range_m > 0.0) return config;
    for (const Lidar& lidar : sequence.lidars)
        config.dataset.max_range_m = std::max(config.dataset.max_range_m, lidar.sensor.max_range_m);
    return config;
}

TraceOptions make_common_trace_options(const Config& config) {
    TraceOptions options;
    options.chunk = config.trace.chunk;
    return options;
}

TraceOptions make_training_trace_options(const Config& config) {
    TraceOptions options = make_common_trace_options(config);
    if (config.loss.likelihood > 0.0f)
        options.likelihood = RangeLikelihoodKernel{config.loss.likelihood_scale_m};
    return options;
}

TraceOptions make_rendering_trace_options(const Config& config) {
    TraceOptions options = make_common_trace_options(config);
    // for output channels and ray-drop networks
    options.normals = get_primitive_properties(config.image.primitive).has_normals;
    if (config.render.range == "mode")
        options.mode_gap_m = static_cast<float>(config.sensor.return_separation_m);
    return options;
}

BackwardOptions make_backward_options(const Config& config) {
    BackwardOptions options;
    if (config.train.deterministic) options.reduction = GradientReduction::gather;
    return options;
}

}  // namespace relidar
