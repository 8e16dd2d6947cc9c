// SPDX-License-Identifier: Apache-2.0
// Renders frames in batches, computes their metrics, and averages the metrics over all
// frames. For a baseline, projects real scans instead of rendering.
#include <relidar/score/evaluation.hpp>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <memory>

#include <relidar/log/range_image.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/score/metrics.hpp>
#include "base/fail.hpp"
#include "score/evaluation/actor_scores.hpp"

namespace relidar {
namespace {

constexpr double kSameTime_s = 1e-3;
// Speeds of a standing sensor, above the jitter of poses that were estimated from scans.
constexpr double kStandingSpeed_mps = 0.1, kStandingTurn_radps = 0.02;
// limited because all images of these frames are in memory
constexpr std::size_t kScoredAtOnce = 16;

/// Returns the sensor with which a frame is rendered. If config.sensor.grid is "native",
/// it fires exactly the rays of the recorded scan.
SimulatedSensor frame_sensor(const Config& config, const Log& log, const Frame& frame) {
    SimulatedSensor sensor = make_sensor(config, log, frame.lidar);
    if (config.sensor.grid == "native") {
        sensor.rays = frame.scan.rays;
        sensor.follows_sweeps = false;
    }
    sensor.rolling_shutter = log.rolling_shutter;
    return sensor;
}

/// Projects a flag of each ray of a scan into the pixels of its measured image. Stores
/// the flags as intensities, because measured_image() projects intensities.
/// @param returned  [rays of the scan] for example: the return is in a moving box
std::vector<bool> flags_to_pixels(const std::vector<bool>& returned, const Config& config,
                                  const Frame& frame) {
    Scan flags = frame.scan;
    std::copy(returned.begin(), returned.end(), flags.intensity.begin());
    const RangeImage binned = measured_image(config, flags);
    return {binned.intensity.begin(), binned.intensity.end()};
}

struct RenderedFrame {
    ScoredFrame frame;  ///< its metrics are those that need no image
    /// [pixels] return in a labelled box of a moving object
    std::vector<bool> moving;
    /// [pixels] return in a moving box without label; empty without such boxes
    std::vector<bool> discovered;
};

/// Returns the measured image of a frame and the masks of its moving boxes.
RenderedFrame make_real_frame(const Config& config, const Log& log, const Frame& frame, const Pose& offset) {
    RenderedFrame result;
    result.frame.frame = frame.index;
    result.frame.lidar = frame.lidar;
    result.frame.time_s = frame.time_s;
    result.frame.start = frame.start;
    result.frame.real = measured_image(config, frame.scan);
    result.moving = flags_to_pixels(mask_labelled_movers(log, frame, offset), config, frame);
    if (std::ranges::find(log.boxes, kDiscoveredCategory, &BoxTrack::category) != log.boxes.end())
        result.discovered = flags_to_pixels(mask_found_movers(log, frame, offset), config, frame);
    return result;
}

/// The frame must have labels, and each pixel must be a recorded ray (grid "native").
bool can_score_classes(const ScanRenderer& renderer, const Config& config, const Frame& frame) {
    return renderer.has_classes() && config.sensor.grid == "native" && !frame.scan.classes.empty();
}

/// Renders a frame with its recorded rays, and returns it with the measured image.
/// @param offset moves the sensor
RenderedFrame render_frame(ScanRenderer& renderer, const Config& config, const Log& log, const Frame& frame,
                           const Pose& offset) {
    RenderedFrame result = make_real_frame(config, log, frame, offset);
    const SimulatedSensor sensor = frame_sensor(config, log, frame);
    result.frame.n_rays = sensor.rays.size();
    result.frame.rendered = renderer.render(sensor, frame.time_s, offset);
    const auto* classes = find_values<std::int32_t>(result.frame.rendered.channels, "class");
    if (classes && can_score_classes(renderer, config, frame))
        result.frame.metrics = score_classes(*classes, frame.scan.classes);
    return result;
}

/// Projects the neighbouring scans of a frame into the image of the frame.
RangeImage project_neighbours(const Config& config, const Log& log, int position,
                              const std::vector<int>& train_frames, BoxPointMotion boxes) {
    const Frame& frame = log.frames[std::size_t(position)];
    Scan points = predict_scan(log, position, train_frames, boxes);
    limit_ranges(points, make_sensor(config, log, frame.lidar).limits);
    // Native grid: each point goes to a ray that the LiDAR fired in this frame.
    return measured_image(config,
                          config.sensor.grid == "native" ? assign_points(frame.scan.rays, points) : points);
}

/// Compares the next scan of a standing sensor with a frame, at depth edges. The scene is
/// the same, so the errors show how exactly the sensor itself repeats a scan.
/// @return an empty row if the sensor moves, or if the rays have no image order
MetricValues score_repeat(const Config& config, const Log& log, int position, const RangeImage& real) {
    const std::optional<int> next = find_repeat(log, position);
    constexpr int kMinColumns = 9;  // of assign_points()
    if (!next || real.rows < 2 || real.columns < kMinColumns ||
        log.frames[std::size_t(*next)].scan.range_m.empty())
        return {};
    return evaluate_regions(project_neighbours(config, log, position, {*next}, BoxPointMotion::follow), real,
                            {{"edges_repeat", mask_edges(real), true}});
}

std::unique_ptr<Lpips> load_lpips() {
    const std::string file = lpips_weights_path();
    return file.empty() ? nullptr : std::make_unique<Lpips>(read_lpips_weights(file));
}

/// Returns the ranges of the points, or those of the image for a baseline, which projects
/// real scans and has no points.
const std::vector<float>& ranges_of_points(const RenderedScan& rendered, const Config& config) {
    const std::vector<float>& points_m = point_ranges(rendered, config);
    return points_m.empty() ? rendered.image.range_m : points_m;
}

/// Clamps ranges to the maximum range of the log and of the grid of the images.
MetricOptions make_metric_options(const Config& config, const Log& log, const Lpips* lpips_network) {
    MetricOptions options;
    options.max_range_m = with_max_range(config, log).dataset.max_range_m;
    if (config.sensor.grid != "native")
        options.max_range_m = std::min(options.max_range_m, find_grid(config.sensor.grid).max_range_m);
    options.lpips = lpips_network;
    return options;
}

/// Computes the metrics of several rendered frames in parallel.
/// @param lpips_network  if null, the metric LPIPS is left out
std::vector<ScoredFrame> score_rendered(std::vector<RenderedFrame> rendered_frames, const Config& config,
                                        const Log& log, const Lpips* lpips_network) {
    std::vector<RangeImageComparison> comparisons;
    for (const RenderedFrame& rendered : rendered_frames) {
        const ScoredFrame& frame = rendered.frame;
        std::vector<PixelRegion> regions = make_regions(frame.real, rendered.moving);
        if (!rendered.discovered.empty()) regions.push_back({"discovered_boxes", rendered.discovered});
        comparisons.push_back({.rendered = &frame.rendered.image,
                               .real = &frame.real,
                               .regions = std::move(regions),
                               .point_range_m = ranges_of_points(frame.rendered, config)});
    }
    std::vector<MetricValues> rows =
        evaluate_all(comparisons, make_metric_options(config, log, lpips_network));
    const auto is_of_intensity = [](const auto& metric) {
        return metric.first.find("intensity") != std::string::npos;
    };
    std::vector<ScoredFrame> frames;
    for (std::size_t i = 0; i < rendered_frames.size(); ++i) {
        ScoredFrame& frame = frames.emplace_back(std::move(rendered_frames[i].frame));
        frame.metrics.merge(rows[i]);
        if (!has_intensities(frame.real)) std::erase_if(frame.metrics, is_of_intensity);
    }
    return frames;
}

void add_actor_scores(ScoredFrame& frame, const Log& log, const Config& config) {
    FrameActorScores scores = score_actors(frame.rendered.image, ranges_of_points(frame.rendered, config),
                                           frame.real, log, {frame.time_s, frame.lidar, frame.start});
    frame.metrics.merge(scores.metrics);
    frame.actors = std::move(scores.actors);
}

/// Counts rays with a real return in a table. Its rows are bands of the real range r, its
/// columns are bands of the absolute range error e:
///   row k:     range edge k < r <= range edge k + 1
///   column k:  error edge k - 1 <= e < error edge k  (0 and infinity at the ends)
/// The last column is for rays without a rendered return. Leaves out r = 0 and r beyond
/// the last edge.
RangeErrorCounts count_range_errors(const RangeImage& rendered, const RangeImage& real) {
    constexpr auto& kRangeEdges = RangeErrorCounts::kRangeEdges_m;
    constexpr auto& kErrorEdges = RangeErrorCounts::kErrorEdges_m;
    RangeErrorCounts counts;
    for (std::size_t ray = 0; ray < real.range_m.size(); ++ray) {
        const double range_m = real.range_m[ray], error_m = std::abs(double(rendered.range_m[ray]) - range_m);
        if (!(range_m > kRangeEdges.front() && range_m <= kRangeEdges.back())) continue;
        const auto range_band = std::ranges::lower_bound(kRangeEdges, range_m) - kRangeEdges.begin() - 1;
        std::ptrdiff_t error_band = std::ptrdiff_t(RangeErrorCounts::kErrorBins) - 1;
        if (is_ray_returned(rendered.drop_prob[ray], rendered.range_m[ray]))
            error_band = std::ranges::upper_bound(kErrorEdges, error_m) - kErrorEdges.begin();
        counts.rays[std::size_t(range_band)][std::size_t(error_band)] += 1.0;
    }
    return counts;
}

/// Frames to score, and where to report them.
struct FrameBatch {
    const std::vector<int>& positions;  ///< indices into log.frames
    const Log& log;
    const Config& config;
    const Progress& progress;
    const ScoredFrameCallback& on_frame;
};

/// Frees the images of a frame. Keeps the rendering time.
void release_images(ScoredFrame& frame) {
    const double trace_ms = frame.rendered.trace_ms;
    frame.rendered = {};
    frame.rendered.trace_ms = trace_ms;
    frame.real = {};
}

/// Renders all frames and computes their metrics. Works in batches, so that the images of
/// few frames are in memory. Only the middle frame keeps its images, as an example.
/// @param render_one_frame  renders a frame, or predicts it for a baseline
std::vector<ScoredFrame> score_frames(
    const FrameBatch& all, const char* progress_text,
    const std::function<RenderedFrame(int position, const Frame&)>& render_one_frame) {
    const std::unique_ptr<Lpips> lpips = load_lpips();
    const std::size_t n = all.positions.size();
    std::vector<ScoredFrame> scored;
    for (std::size_t first = 0; first < n; first += kScoredAtOnce) {
        std::vector<RenderedFrame> batch;
        for (std::size_t i = first; i < std::min(first + kScoredAtOnce, n); ++i) {
            if (all.progress) all.progress(progress_text, double(i) / double(n));
            const int position = all.positions[i];
            const Frame& measured = all.log.frames.at(std::size_t(position));
            RenderedFrame& rendered = batch.emplace_back(render_one_frame(position, measured));
            ScoredFrame& frame = rendered.frame;
            frame.metrics.merge(score_repeat(all.config, all.log, position, frame.real));
        }
        for (ScoredFrame& frame : score_rendered(std::move(batch), all.config, all.log, lpips.get())) {
            add_actor_scores(frame, all.log, all.config);
            frame.range_errors = count_range_errors(frame.rendered.image, frame.real);
            if (all.on_frame) all.on_frame(frame);
            const bool is_example = scored.size() == n / 2;
            if (!is_example) release_images(frame);
            scored.push_back(std::move(frame));
        }
    }
    if (all.progress && n > 0) all.progress(progress_text, 1.0);
    return scored;
}

}  // namespace

std::optional<int> find_repeat(const Log& log, int frame_index) {
    const Frame& frame = log.frames.at(std::size_t(frame_index));
    const auto next = std::find_if(log.frames.begin() + frame_index + 1, log.frames.end(),
                                   [&](const Frame& f) { return f.lidar == frame.lidar; });
    if (next == log.frames.end() || !(next->time_s > frame.time_s)) return {};
    const PoseTrack track = log.lidar_track(frame.lidar);
    const Twist motion = compute_twist(track.pose_at(frame.time_s), track.pose_at(next->time_s));
    const double step_s = next->time_s - frame.time_s;
    const double moved_m = std::hypot(motion[0], motion[1], motion[2]);
    const double turned_rad = std::hypot(motion[3], motion[4], motion[5]);
    if (moved_m > kStandingSpeed_mps * step_s || turned_rad > kStandingTurn_radps * step_s) return {};
    return int(next - log.frames.begin());
}

void copy_scans(Run& run, const std::vector<int>& frame_indices, const Log& log) {
    const auto copy_scan = [&](int position) {
        Frame& frame = run.log.frames[static_cast<std::size_t>(position)];
        const auto recorded = std::ranges::find_if(log.frames, [&](const Frame& other) {
            return other.index == frame.index && other.lidar == frame.lidar;
        });
        if (recorded == log.frames.end())
            fail("{} has no frame {}, but {} was trained with this frame; use the same log",
                 run.config.dataset.path, frame.index, run.folder.string());
        if (std::abs(recorded->time_s - frame.time_s) > kSameTime_s)
            fail("{}: frame {} has the time {} s, but it had {} s when {} was trained; use the same log",
                 run.config.dataset.path, frame.index, recorded->time_s, frame.time_s, run.folder.string());
        frame.scan = recorded->scan;
        frame.start = recorded->start;  // computed from the scan when the log is loaded
    };
    for (const int position : frame_indices) {
        copy_scan(position);
        if (const std::optional<int> repeat = find_repeat(run.log, position)) copy_scan(*repeat);
    }
}

ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Log& log, const Frame& frame,
                        const Pose& offset) {
    const std::unique_ptr<Lpips> lpips = load_lpips();
    return score_rendered({render_frame(renderer, config, log, frame, offset)}, config, log, lpips.get())
        .front();
}

Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Log& log,
                           const std::vector<int>& frame_indices, const Progress& progress,
                           const ScoredFrameCallback& on_frame) {
    // For reports: the drop probability of the surfels, before the network corrects it.
    if (on_frame && renderer.has_network_for(make_sensor(config, log)))
        renderer.add_channels("surfel_drop_prob");
    // For the metrics classes/*.
    const auto has_classes = [&](int position) {
        return can_score_classes(renderer, config, log.frames.at(std::size_t(position)));
    };
    if (std::ranges::any_of(frame_indices, has_classes)) renderer.add_channels("class");
    const auto render = [&](int, const Frame& frame) {
        return render_frame(renderer, config, log, frame, {});
    };
    std::vector<ScoredFrame> scored =
        score_frames({frame_indices, log, config, progress, on_frame}, "rendering held-out frames", render);
    return summarise(std::move(scored), renderer.times());
}

BoxPointMotion parse_baseline(const std::string& baseline_name) {
    if (baseline_name == "nearest") return BoxPointMotion::stay;
    if (baseline_name == "nearest-actors") return BoxPointMotion::follow;
    fail<UsageError>("baseline: found \"{}\", expected nearest or nearest-actors", baseline_name);
}

Evaluation evaluate_baseline(const std::string& baseline_name, const Config& config, const Log& log,
                             const Split& split, const Progress& progress,
                             const ScoredFrameCallback& on_frame) {
    const BoxPointMotion box_motion = parse_baseline(baseline_name);
    const auto project = [&](int position, const Frame& frame) {
        RenderedFrame result = make_real_frame(config, log, frame, {});
        result.frame.rendered.image = project_neighbours(config, log, position, split.train, box_motion);
        return result;
    };
    const KernelTimes no_kernels;  // a baseline does not use the device
    Evaluation evaluation = summarise(score_frames({split.test, log, config, progress, on_frame},
                                                   "projecting neighbours of held-out frames", project),
                                      no_kernels);
    evaluation.title = "baseline " + baseline_name;
    return evaluation;
}

void check_lpips_weights() { load_lpips(); }

std::string lpips_weights_path() {
    const char* file = std::getenv("RELIDAR_LPIPS_WEIGHTS");
    return file ? file : "";
}

MetricValues mean_kernel_ms(const KernelTimes& kernel_times) {
    MetricValues row;
    for (const auto& [kernel, total] : kernel_times.totals) row[kernel] = total.ms / total.launches;
    return row;
}

Evaluation summarise(std::vector<ScoredFrame> scored_frames, const KernelTimes& kernel_times) {
    Evaluation evaluation;
    std::vector<MetricValues> rows;
    std::vector<std::vector<ActorScore>> actors;
    double n_rays = 0.0;
    for (const ScoredFrame& frame : scored_frames) {
        rows.push_back(frame.metrics);
        actors.push_back(frame.actors);
        evaluation.trace_ms += frame.rendered.trace_ms / static_cast<double>(scored_frames.size());
        n_rays += static_cast<double>(frame.n_rays) / static_cast<double>(scored_frames.size());
    }
    evaluation.mean = mean_metrics(rows);
    evaluation.actors = average_scores(actors);
    if (const std::optional<double> error = median_points_error(evaluation.actors))
        evaluation.mean["actors/vehicles_points_error"] = *error;
    evaluation.kernel_ms = mean_kernel_ms(kernel_times);
    // Mean rays per scan over mean milliseconds per scan, in millions per second.
    if (evaluation.trace_ms > 0.0) evaluation.mrays_per_s = n_rays / (1000.0 * evaluation.trace_ms);
    evaluation.frames = std::move(scored_frames);
    return evaluation;
}

}  // namespace relidar
