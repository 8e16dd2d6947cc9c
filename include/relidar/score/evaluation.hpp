// SPDX-License-Identifier: Apache-2.0
// Evaluation: renders frames, compares them with the measured frames and computes
// metrics. Used for the held-out frames of a run, and for a simple baseline.
#pragma once

#include <array>
#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Rays with a measured return by measured range and by error of the rendered range.
struct RangeErrorCounts {
    /// of the real range
    static constexpr std::array<double, 7> kRangeEdges_m{0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0};
    static constexpr std::array<double, 3> kErrorEdges_m{0.05, 0.2, 1.0};
    /// edges + 1, plus a last bin for rays without rendered return
    static constexpr std::size_t kErrorBins = kErrorEdges_m.size() + 2;

    std::array<std::array<double, kErrorBins>, kRangeEdges_m.size() - 1> rays{};
};

/// Scores of the points of a moving box in one frame, or in all frames of an evaluation.
///   points, points_real   number of simulated and of real points in the box
///   range_medae_m         median of the absolute range errors
///   range_bias_m          median of the range errors, simulated minus real
///   range_above_30cm      fraction of the range errors above 0.3 m
///   f1                    F1 score of the rays that return from the box (silhouette)
///   tail, tail_real       number of simulated and real points in the comet tail: where
///                         the box is at another time of the log, but no box is now
struct ActorScore {
    std::string track;     ///< Id of the box.
    std::string category;  ///< name_of(class_of()) the box
    MetricValues metrics;  ///< Metrics that are not defined are left out.
    bool is_discovered = false;
};

struct ScoredFrame {
    int frame = 0;  ///< frame number of the dataset
    int lidar = 0;  ///< index of its LiDAR
    double time_s = 0.0;
    std::optional<SweepStart> start = {};  ///< azimuth and time of the sweep's start; empty if default
    /// Differs from the number of pixels if points are binned into an image.
    std::size_t n_rays = 0;
    /// Only the middle frame of an evaluation keeps its scan, the others only the
    /// rendering time.
    RenderedScan rendered;
    RangeImage real;  ///< Measured image. Only frames that keep the rendered scan also keep this image.
    MetricValues metrics;
    RangeErrorCounts range_errors;
    std::vector<ActorScore> actors;  ///< Scores of the moving boxes that are present.
};

struct MovingBoxPoints {
    /// [n,3] frame of the box at the time at which each point was measured
    std::vector<glm::dvec3> real_m, simulated_m;
    /// Simulated minus real, for rays that return in both scans with the real point in
    /// the box.
    std::vector<double> range_error_m;
    /// Rays that hit the box: in both scans, only in the real scan, only in the simulated
    /// scan.
    std::size_t n_both = 0, n_missed = 0, n_false = 0;
};

/// Returns the points in a box that is enlarged by 0.1 m, without the lowest 0.15 m
/// (ground). Counts the rays that hit the box enlarged by 0.3 m.
/// @param point_ranges_m [n] ranges at which the simulated points are placed
/// @param sweep  the sweep of both images
/// @param box  a box that is present at the time of the sweep
MovingBoxPoints points_in_box(const RangeImage& rendered, const std::vector<float>& point_ranges_m,
                              const RangeImage& real, const Log& log, const SweepTiming& sweep,
                              const BoxTrack& box);

/// Called with the images of a frame after its metrics were computed. It may add metrics.
using ScoredFrameCallback = std::function<void(ScoredFrame&)>;

struct Evaluation {
    std::string title = "rendered";  ///< What was scored: "rendered" or the name of a baseline.
    std::vector<ScoredFrame> frames;
    MetricValues mean;
    /// Over all frames. Boxes with the highest fraction of range errors above 0.3 m come
    /// first. Numbers of points are sums, other metrics are means weighted by the real
    /// points of a frame.
    std::vector<ActorScore> actors;
    MetricValues kernel_ms;  ///< Mean time of a kernel launch in milliseconds, by kernel name.
    double trace_ms = 0.0;   ///< Mean time to render a frame, including transfers to and from the device.
    double mrays_per_s = 0.0;
};

/// Returns the index of the next sweep of the same LiDAR, if the sensor stands still
/// between the frame and this sweep. If this sweep has a scan, evaluate_frames() adds
/// edges_repeat/*: the metrics of edges/* for this scan instead of the rendered scan.
/// They show how well a sensor repeats scans.
std::optional<int> find_repeat(const Log& log, int frame_index);

/// Copies scans of a log into frames of a run that was trained on it. Also copies the
/// scan after a frame if the sensor stands still, because it is scored as a repetition.
/// The poses of the run do not change.
/// @param frame_indices  indices into Run::log of the frames
/// @throws DataError if a frame is missing in the log, or has another time in the log
void copy_scans(Run& run, const std::vector<int>& frame_indices, const Log& log);

/// Renders a frame at the pose of the real sensor, along the rays of the real scan or
/// binned into another grid like the real points.
/// @param offset  pose of the sensor that made frame.scan, in the frame of the
/// log's sensor
ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Log& log, const Frame& frame,
                        const Pose& offset = {});

/// Renders frames and computes their metrics. Memory use does not grow with their number.
/// @param frame_indices  indices of the frames in `log`
/// @param progress  called before each frame and after the last one
/// @throws DataError if a file with LPIPS weights is set and cannot be read
Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Log& log,
                           const std::vector<int>& frame_indices, const Progress& progress = {},
                           const ScoredFrameCallback& on_frame = {});

/// Computes the mean metrics of scored frames.
/// @param kernel_times  of the renderer that rendered the frames
Evaluation summarise(std::vector<ScoredFrame> scored_frames, const KernelTimes& kernel_times);

/// Returns the mean time of a launch in milliseconds, by kernel name.
MetricValues mean_kernel_ms(const KernelTimes& kernel_times);

/// Returns how a baseline moves points in moving boxes. It predicts a scan from the
/// points of the neighbouring training scans. "nearest" keeps points where they were
/// measured, "nearest-actors" moves points in a box with it.
/// @throws UsageError for another name
BoxPointMotion parse_baseline(const std::string& baseline_name);
/// Scores a baseline on the held-out frames of a log with its scans.
/// @param progress  called before each frame and after the last one
/// @throws UsageError for another name
Evaluation evaluate_baseline(const std::string& baseline_name, const Config& config, const Log& log,
                             const Split& split, const Progress& progress = {},
                             const ScoredFrameCallback& on_frame = {});

/// Reads the file with LPIPS weights, if the user has set one. Called before a long
/// evaluation, so that a damaged file is reported at the start.
/// @throws DataError if the file is damaged or an array is missing
void check_lpips_weights();
/// Returns the environment variable RELIDAR_LPIPS_WEIGHTS. If it is empty, LPIPS is not
/// computed.
std::string lpips_weights_path();

}  // namespace relidar
