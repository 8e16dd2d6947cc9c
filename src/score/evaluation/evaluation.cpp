// SPDX-License-Identifier: Apache-2.0
// Renders frames in batches, computes their metrics, and averages the metrics over all
// frames. For a baseline, real scans are projected instead of rendered.
#include <relidar/score/evaluation.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <memory>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/score/metrics.hpp>
#include "score/evaluation/actor_scores.hpp"

namespace relidar {
namespace {

constexpr double kSameTime_s = 1e-3;
// Number of frames whose metrics are computed in parallel. All images of these frames are
// in memory at the same time.
constexpr std::size_t kScoredAtOnce = 16;

/// Returns the sensor with which a frame is rendered, as set by config.sensor. For the
/// grid "native", renders exactly the rays of the recorded scan.
/// @param frame  the frame, with its scan
SensorChoice make_sensor_of_frame(const Config& config, const Sequence& sequence, const Frame& frame) {
    SensorChoice sensor = make_configured_sensor(config, sequence, frame.lidar);
    if (config.sensor.grid == "native") sensor.rays = frame.scan.rays, sensor.follows_sweeps = false;
    sensor.rolling_shutter = sequence.rolling_shutter;
    return sensor;
}

/// Converts one flag per return of a scan to one flag per image pixel. Stores the flags
/// as intensities of the scan and projects the scan into the image.
std::vector<bool> convert_return_flags_to_pixels(const std::vector<bool>& returns, const Config& config,
                                                 const Frame& frame) {
    Scan flags = frame.scan;
    std::copy(returns.begin(), returns.end(), flags.intensity.begin());
    const RangeImage binned = make_real_image(config, flags);
    return {binned.intensity.begin(), binned.intensity.end()};
}

/// A frame that was rendered but not scored yet.
struct RenderedFrame {
    ScoredFrame frame;
    /// [n] true for pixels whose return is in a labelled box of a moving object.
    std::vector<bool> moving;
    /// [n] true for pixels whose return is in the box of a moving object that has no
    /// label. Empty if the run has no such boxes.
    std::vector<bool> discovered;
    MetricRow class_scores;  ///< scores of the channel `class`; empty without labels

    std::vector<Region> make_frame_regions() const {
        std::vector<Region> regions = make_standard_regions(frame.real, moving);
        if (!discovered.empty()) regions.push_back({"discovered_boxes", discovered});
        return regions;
    }
};

RenderedFrame make_real_frame(const Config& config, const Sequence& sequence, const Frame& frame,
                              const Pose& sensor_offset) {
    RenderedFrame result;
    result.frame.frame = frame.index;
    result.frame.lidar = frame.lidar;
    result.frame.time_s = frame.time_s;
    result.frame.start = frame.start;
    result.frame.real = make_real_image(config, frame.scan);
    result.moving =
        convert_return_flags_to_pixels(find_moving_returns(sequence, frame, sensor_offset), config, frame);
    if (std::ranges::find(sequence.boxes, kDiscoveredCategory, &BoxTrack::category) != sequence.boxes.end())
        result.discovered = convert_return_flags_to_pixels(
            find_discovered_returns(sequence, frame, sensor_offset), config, frame);
    return result;
}

/// Returns true if the classes of a rendered frame can be compared with labels. With
/// another grid, labels and pixels do not correspond.
bool has_class_scores(const ScanRenderer& renderer, const Config& config, const Frame& frame) {
    return renderer.has_classes() && config.sensor.grid == "native" && !frame.scan.classes.empty();
}

RenderedFrame render_frame(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                           const Frame& frame, const Pose& sensor_offset) {
    RenderedFrame result = make_real_frame(config, sequence, frame, sensor_offset);
    const SensorChoice sensor = make_sensor_of_frame(config, sequence, frame);
    result.frame.n_rays = sensor.rays.size();
    result.frame.rendered = renderer.render(sensor, frame.time_s, sensor_offset);
    const auto* classes = find_values<std::int32_t>(result.frame.rendered.channels, "class");
    if (classes && has_class_scores(renderer, config, frame))
        result.class_scores = evaluate_classes(*classes, frame.scan.classes);
    return result;
}

/// Loads the LPIPS network if a file with weights is set. Returns null otherwise.
std::unique_ptr<Lpips> load_lpips() {
    const std::string file = find_lpips_weights();
    return file.empty() ? nullptr : std::make_unique<Lpips>(read_lpips_weights(file));
}

/// Computes the metrics of several rendered frames in parallel.
/// @param lpips  network for the LPIPS metric; null: leaves out this metric
std::vector<ScoredFrame> score_rendered_frames(std::vector<RenderedFrame> rendered, const Config& config,
                                               const Sequence& sequence, const Lpips* lpips) {
    MetricOptions options;
    options.max_range_m = use_farthest_return(config, sequence).dataset.max_range_m;
    if (config.sensor.grid != "native")
        options.max_range_m = std::min(options.max_range_m, find_grid(config.sensor.grid).max_range_m);
    options.lpips = lpips;
    std::vector<Comparison> comparisons;
    for (const RenderedFrame& r : rendered)
        comparisons.push_back({&r.frame.rendered.image, &r.frame.real, r.make_frame_regions(),
                               select_point_ranges(r.frame.rendered, config)});
    const std::vector<MetricRow> rows = evaluate_all(comparisons, options);
    std::vector<ScoredFrame> frames;
    for (std::size_t i = 0; i < rendered.size(); ++i) {
        frames.push_back(std::move(rendered[i].frame));
        frames.back().metrics = rows[i];
        frames.back().metrics.merge(rendered[i].class_scores);
        if (!has_intensities(frames.back().real))
            std::erase_if(frames.back().metrics, [](const auto& metric) {
                return metric.first.find("intensity") != std::string::npos;
            });
    }
    return frames;
}

void add_actor_scores(std::vector<ScoredFrame>& frames, const Sequence& sequence, const Config& config) {
    for (ScoredFrame& frame : frames) {
        const SweepMoment sweep{frame.time_s, frame.lidar, frame.start};
        const RangeImage& rendered = frame.rendered.image;
        // Empty for a baseline without a renderer. In this case, the ranges of the image
        // are used.
        const std::vector<float>& points_m = select_point_ranges(frame.rendered, config);
        ActorScores scores = compute_actor_scores(rendered, points_m.empty() ? rendered.range_m : points_m,
                                                  frame.real, sequence, sweep);
        frame.metrics.merge(scores.metrics);
        frame.actors = std::move(scores.actors);
    }
}

RangeErrorCounts count_range_errors(const RangeImage& rendered, const RangeImage& real) {
    constexpr auto& kRanges = RangeErrorCounts::kRangeEdges_m;
    constexpr auto& kErrors = RangeErrorCounts::kErrorEdges_m;
    RangeErrorCounts counts;
    for (std::size_t i = 0; i < real.range_m.size(); ++i) {
        const double range_m = real.range_m[i], error_m = std::abs(double(rendered.range_m[i]) - range_m);
        if (!(range_m > kRanges.front() && range_m <= kRanges.back())) continue;
        const auto row =
            std::size_t(std::lower_bound(kRanges.begin(), kRanges.end(), range_m) - kRanges.begin()) - 1;
        const auto band =
            std::size_t(std::upper_bound(kErrors.begin(), kErrors.end(), error_m) - kErrors.begin());
        counts.rays[row][is_returned(rendered.drop_prob[i], rendered.range_m[i])
                             ? band
                             : RangeErrorCounts::kBands - 1] += 1.0;
    }
    return counts;
}

void clear_frame_images(ScoredFrame& frame) {
    const double trace_ms = frame.rendered.trace_ms;
    frame.rendered = {};
    frame.rendered.trace_ms = trace_ms;
    frame.real = {};
}

/// Parameters of an evaluation of many frames. To limit memory, frames are rendered and
/// scored in small batches. Each batch frees its images before the next one starts.
struct ManyFrames {
    const std::vector<int>& positions;  ///< indices into sequence.frames
    const Sequence& sequence;
    const Config& config;
    const Progress& progress;
    const FrameCallback& see;
};

/// Renders all frames and computes their metrics, in batches of kScoredAtOnce frames.
/// @param description  text shown with the progress
/// @param render  function that renders one frame
std::vector<ScoredFrame> score_frames(
    const ManyFrames& frames, const char* description,
    const std::function<RenderedFrame(int position, const Frame&)>& render) {
    const std::unique_ptr<Lpips> lpips = load_lpips();
    const std::size_t n = frames.positions.size();
    std::vector<ScoredFrame> scored;
    for (std::size_t first = 0; first < n; first += kScoredAtOnce) {
        std::vector<RenderedFrame> batch;
        for (std::size_t i = first; i < std::min(first + kScoredAtOnce, n); ++i) {
            if (frames.progress) frames.progress(description, double(i) / double(n));
            batch.push_back(
                render(frames.positions[i], frames.sequence.frames.at(std::size_t(frames.positions[i]))));
        }
        std::vector<ScoredFrame> scored_batch =
            score_rendered_frames(std::move(batch), frames.config, frames.sequence, lpips.get());
        add_actor_scores(scored_batch, frames.sequence, frames.config);
        for (ScoredFrame& frame : scored_batch) {
            frame.range_errors = count_range_errors(frame.rendered.image, frame.real);
            if (frames.see) frames.see(frame);
            if (scored.size() != n / 2) clear_frame_images(frame);
            scored.push_back(std::move(frame));
        }
    }
    if (frames.progress && n > 0) frames.progress(description, 1.0);
    return scored;
}

}  // namespace

void attach_scans(Run& run, const std::vector<int>& positions, const Sequence& log) {
    for (const int position : positions) {
        Frame& frame = run.sequence.frames[static_cast<std::size_t>(position)];
        const auto it = std::find_if(log.frames.begin(), log.frames.end(), [&](const Frame& f) {
            return f.index == frame.index && f.lidar == frame.lidar;
        });
        if (it == log.frames.end())
            throw DataError(
                fmt::format("{} has no frame {}, but {} was trained with this frame; use the same log",
                            run.config.dataset.path, frame.index, run.folder.string()));
        if (std::abs(it->time_s - frame.time_s) > kSameTime_s) {
            throw DataError(fmt::format(
                "{}: frame {} has the time {} s, but it had {} s when {} was trained; use the same log",
                run.config.dataset.path, frame.index, it->time_s, frame.time_s, run.folder.string()));
        }
        frame.scan = it->scan;
        frame.start = it->start;
    }
}

ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                        const Frame& frame, const Pose& sensor_offset) {
    const std::unique_ptr<Lpips> lpips = load_lpips();
    return score_rendered_frames({render_frame(renderer, config, sequence, frame, sensor_offset)}, config,
                                 sequence, lpips.get())
        .front();
}

Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                           const std::vector<int>& positions, const Progress& progress,
                           const FrameCallback& on_frame) {
    // Also renders the drop probability without the correction by the neural network,
    // because reports show both.
    if (on_frame && renderer.refines(make_configured_sensor(config, sequence)))
        renderer.enable_channels("surfel_drop_prob");
    if (std::ranges::any_of(positions, [&](int position) {
            return has_class_scores(renderer, config, sequence.frames.at(std::size_t(position)));
        }))
        renderer.enable_channels("class");
    std::vector<ScoredFrame> scored = score_frames(
        {positions, sequence, config, progress, on_frame}, "rendering held-out frames",
        [&](int, const Frame& frame) { return render_frame(renderer, config, sequence, frame, {}); });
    return summarise(std::move(scored), renderer.times());
}

BoxMotion find_baseline(const std::string& name) {
    if (name == "nearest") return BoxMotion::stay;
    if (name == "nearest-actors") return BoxMotion::follow;
    throw UsageError(fmt::format("baseline: found \"{}\", expected nearest or nearest-actors", name));
}

Evaluation evaluate_baseline(const std::string& name, const Config& config, const Sequence& sequence,
                             const Split& split, const Progress& progress, const FrameCallback& on_frame) {
    const BoxMotion boxes = find_baseline(name);
    const auto project = [&](int position, const Frame& frame) {
        RenderedFrame result = make_real_frame(config, sequence, frame, {});
        Scan points = predict_neighbour_points(sequence, position, split.train, boxes);
        drop_outside_limits(points, make_configured_sensor(config, sequence, frame.lidar).limits);
        result.frame.rendered.image = make_real_image(
            config, config.sensor.grid == "native" ? bin_onto_rays(frame.scan.rays, points) : points);
        return result;
    };
    Evaluation evaluation = summarise(score_frames({split.test, sequence, config, progress, on_frame},
                                                   "projecting neighbours of held-out frames", project),
                                      {});
    evaluation.title = "baseline " + name;
    return evaluation;
}

void check_lpips_weights() { load_lpips(); }

std::string find_lpips_weights() {
    const char* file = std::getenv("RELIDAR_LPIPS_WEIGHTS");
    return file ? file : "";
}

MetricRow compute_mean_times(const KernelTimes& times) {
    MetricRow row;
    for (const auto& [kernel, total] : times.totals) row[kernel] = total.ms / total.launches;
    return row;
}

Evaluation summarise(std::vector<ScoredFrame> frames, const KernelTimes& times) {
    Evaluation evaluation;
    std::vector<MetricRow> rows;
    std::vector<std::vector<ActorScore>> actors;
    double n_rays = 0.0;
    for (const ScoredFrame& frame : frames) {
        rows.push_back(frame.metrics);
        actors.push_back(frame.actors);
        evaluation.trace_ms += frame.rendered.trace_ms / static_cast<double>(frames.size());
        n_rays += static_cast<double>(frame.n_rays) / static_cast<double>(frames.size());
    }
    evaluation.mean = mean(rows);
    evaluation.actors = average_over_frames(actors);
    evaluation.kernel_ms = compute_mean_times(times);
    if (evaluation.trace_ms > 0.0) evaluation.mrays_per_s = n_rays / (1000.0 * evaluation.trace_ms);
    evaluation.frames = std::move(frames);
    return evaluation;
}

}  // namespace relidar
