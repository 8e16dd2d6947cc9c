// SPDX-License-Identifier: Apache-2.0
#include "evaluation.hpp"

#include <algorithm>
#include <numeric>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "interrupt.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

SensorChoice sensor_of(const Config& config, const Sequence& sequence, const Frame& frame) {
    if (config.sensor.grid == "native") return {frame.scan.rays, std::nullopt, true};
    return configured_sensor(config, sequence);
}

Json protocol_json(const Config& config) {
    return {{"frames", "held out of training; mean over frames, metric by metric, over the frames that have it"},
            {"grid", config.sensor.grid},
            {"grid_method", config.sensor.grid == "native" ? "rays of the real scan" : config.sensor.grid_method},
            {"range", config.render.range},
            {"max_range_m", config.dataset.max_range_m},
            {"peer", "all pixels, dropped ones at 0, ranges clamped to [1e-6, max_range_m]; returned where drop_prob < 0.4; squared Chamfer distance, F-score at 0.05 m^2 squared distance"},
            {"strict", "pixels returned in both, drop_prob < 0.5; Chamfer distance both ways summed; F-score at 5 cm and 22.4 cm; drop metrics with dropped as positive"}};
}

}  // namespace

ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Sequence& sequence, const Frame& frame, const Pose& sensor_offset) {
    ScoredFrame scored;
    scored.frame = frame.index;
    scored.time_s = frame.time_s;
    const SensorChoice sensor = sensor_of(config, sequence, frame);
    scored.n_rays = sensor.rays.size();
    scored.rendered = renderer.render(sensor, frame.time_s, sensor_offset);
    scored.real = real_image(config, frame.scan);
    MetricOptions options;
    options.max_range_m = config.dataset.max_range_m;
    scored.metrics = evaluate(scored.rendered.image, scored.real, options);
    return scored;
}

Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Sequence& sequence, const std::vector<int>& positions, Progress& progress) {
    std::vector<ScoredFrame> frames;
    for (const int position : positions) {
        stop_if_interrupted();
        frames.push_back(score_frame(renderer, config, sequence, sequence.frames.at(static_cast<std::size_t>(position))));
        progress.count("evaluating frame", frames.size(), positions.size());
    }
    return summarise(std::move(frames), renderer.times());
}

MetricRow mean_times(const KernelTimes& times) {
    MetricRow row;
    for (const auto& [kernel, ms] : times.milliseconds) {
        if (!ms.empty()) row[kernel] = std::accumulate(ms.begin(), ms.end(), 0.0) / static_cast<double>(ms.size());
    }
    return row;
}

Evaluation summarise(std::vector<ScoredFrame> frames, const KernelTimes& times) {
    Evaluation evaluation;
    std::vector<MetricRow> rows;
    double n_rays = 0.0;
    for (const ScoredFrame& frame : frames) {
        rows.push_back(frame.metrics);
        evaluation.trace_ms += frame.rendered.trace_ms / static_cast<double>(frames.size());
        n_rays += static_cast<double>(frame.n_rays) / static_cast<double>(frames.size());
    }
    evaluation.mean = mean(rows);
    evaluation.kernel_ms = mean_times(times);
    if (evaluation.trace_ms > 0.0) evaluation.mrays_per_s = n_rays / (1000.0 * evaluation.trace_ms);
    evaluation.frames = std::move(frames);
    return evaluation;
}

std::string metric_table(const Evaluation& evaluation) {
    const bool spread = evaluation.frames.size() > 1;
    std::vector<std::vector<std::string>> rows{{"metric", "value"}};
    if (spread) rows = {{"metric", "mean", "lowest", "highest"}};
    for (const auto& [name, mean_value] : evaluation.mean) {
        double low = mean_value, high = mean_value;
        for (const ScoredFrame& frame : evaluation.frames) {
            const auto it = frame.metrics.find(name);
            if (it == frame.metrics.end()) continue;
            low = std::min(low, it->second);
            high = std::max(high, it->second);
        }
        rows.push_back({name, number(mean_value)});
        if (spread) rows.back().insert(rows.back().end(), {number(low), number(high)});
    }
    return table(rows);
}

std::string metrics_json(const Evaluation& evaluation, const Config& config, const MetricsOrigin& origin) {
    Json frames = Json::array();
    for (const ScoredFrame& f : evaluation.frames) frames.push_back({{"frame", f.frame}, {"time_s", f.time_s}, {"trace_ms", f.rendered.trace_ms}, {"metrics", f.metrics}});
    const Json json = {{"format", "relidar metrics"},
                       {"version", 1},
                       {"relidar", RELIDAR_VERSION},
                       {"run", origin.run},
                       {"dataset", config.dataset.path},
                       {"protocol", protocol_json(config)},
                       {"mean", evaluation.mean},
                       {"frames", frames},
                       {"timings", {{"kernel_ms", evaluation.kernel_ms}, {"trace_ms", evaluation.trace_ms}, {"mrays_per_s", evaluation.mrays_per_s}, {"seconds", origin.seconds}}},
                       {"device", origin.device},
                       {"peak_device_bytes", origin.peak_device_bytes}};
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace relidar::cli
