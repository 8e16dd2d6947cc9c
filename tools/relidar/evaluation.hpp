// SPDX-License-Identifier: Apache-2.0
// Rendered frames beside real ones: pictures come from the images, numbers from relidar/metrics.hpp.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/render.hpp>

namespace relidar::cli {

class Progress;

/// A frame rendered on the rays of the real one, and how close it came.
struct ScoredFrame {
    int frame = 0;          ///< the dataset's own number
    int lidar = 0;          ///< that took it
    double time_s = 0.0;
    std::size_t n_rays = 0; ///< traced; a grid of binned points has fewer pixels or more
    RenderedScan rendered;
    RangeImage real;
    MetricRow metrics;
};

struct Evaluation {
    std::string title = "rendered";   ///< what was scored
    std::vector<ScoredFrame> frames;
    MetricRow mean;
    MetricRow kernel_ms;       ///< mean of one launch
    double trace_ms = 0.0;     ///< mean of one frame, with transfers
    double mrays_per_s = 0.0;
};

/// Renders a frame at the place of the real sensor and compares. With the native grid the rays are those of the real scan;
/// a grid compares simulated points binned as the real ones were.
/// @param sequence  of the renderer @param frame with its scan @param sensor_offset of the sensor that made frame.scan
ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Sequence& sequence, const Frame& frame, const Pose& sensor_offset = {});

/// Scores frames of `sequence` by their positions in it. @throws Error with exit code 130 where the user interrupts
Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Sequence& sequence, const std::vector<int>& positions, Progress& progress);

/// Means of scored frames. @param times of the renderer that made them
Evaluation summarise(std::vector<ScoredFrame> frames, const KernelTimes& times);

/// Mean milliseconds a launch, by kernel.
MetricRow mean_times(const KernelTimes& times);

/// What the baseline `nearest` or `nearest-actors` does with moving boxes. @throws UsageError for another name
BoxMotion box_motion(const std::string& baseline);

/// A baseline on frames of a log with its scans: what projecting the neighbouring training scans gives. @throws as box_motion
Evaluation evaluate_baseline(const std::string& name, const Config& config, const Sequence& sequence, const Split& split, Progress& progress);

/// Reads the weights of LPIPS, where some are named, to notice a wrong file before the long work. @throws DataError as read_lpips_weights
void check_lpips_weights(const Config& config);

/// The file with the weights of LPIPS: eval.lpips_weights, else what RELIDAR_LPIPS_WEIGHTS names, else none.
std::string lpips_file(const Config& config);

/// Metric tables for the terminal: mean, lowest and highest of the frames, the mean of the baseline where there is one, errors by
/// region, and what the names mean.
std::string metric_table(const Evaluation& evaluation, const Evaluation* baseline = nullptr);

/// What a metrics.json needs beside the numbers.
struct MetricsOrigin {
    std::string run;               ///< path of the run; empty without one
    std::string device;
    std::uint64_t peak_device_bytes = 0;
    double seconds = 0.0;
    const Evaluation* baseline = nullptr;
};
/// Per frame and mean, with protocol, timings, device and memory.
std::string metrics_json(const Evaluation& evaluation, const Config& config, const MetricsOrigin& origin);

}  // namespace relidar::cli
