// SPDX-License-Identifier: Apache-2.0
// Evaluation: renders frames, compares them with the real ones and computes metrics.
// Scores a run on its held-out frames, and a simple baseline for comparison.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar {

/// Histogram of the rays with a real return, by the real range and by the error of the
/// rendered range.
struct RangeErrorCounts {
    /// limits of the bins of the real range
    static constexpr std::array<double, 7> kRangeEdges_m{0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0};
    static constexpr std::array<double, 3> kErrorEdges_m{0.05, 0.2, 1.0};
    /// Number of error bins. The last one counts rays that have no rendered return.
    static constexpr std::size_t kBands = kErrorEdges_m.size() + 2;

    std::array<std::array<double, kBands>, kRangeEdges_m.size() - 1> rays{};
};

/// A frame that was rendered on the rays of the real scan, with its metrics.
struct ScoredFrame {
    int frame = 0;  ///< frame number of the dataset
    int lidar = 0;  ///< index of its LiDAR
    double time_s = 0.0;
    std::optional<SweepStart> start = {};  ///< start of the sweep, see Frame
    /// number of traced rays; an image of binned points can have fewer or more pixels
    std::size_t n_rays = 0;
    /// Rendered scan. In an evaluation of many frames, only the middle frame keeps it;
    /// the other frames keep only its time.
    RenderedScan rendered;
    RangeImage real;  ///< measured image; kept for the same frames as `rendered`
    MetricRow metrics;
    RangeErrorCounts range_errors;
};

/// Measured and simulated points in the box of a person or cyclist.
struct PeoplePoints {
    /// [n,3] in the frame of the box at the time at which the point was measured
    std::vector<glm::dvec3> real_m, simulated_m;
    /// Number of rays that hit the box: in both scans, only in the real scan, only in the
    /// simulated scan.
    std::size_t n_both = 0, n_missed = 0, n_false = 0;
};

/// Collects the measured and simulated points in a box that is enlarged by 0.1 m. Skips
/// the lowest 0.15 m, which contains ground points. For the counts of rays, the box is
/// enlarged by 0.3 m.
/// @param rendered  rendered image
/// @param points_m [n] ranges of the simulated points, see point_ranges()
/// @param real  measured image of the same rays
/// @param seen  the sweep of both images
/// @param box  a box that is present at the time of the sweep
PeoplePoints people_points(const RangeImage& rendered, const std::vector<float>& points_m,
                           const RangeImage& real, const Sequence& sequence, const SweepMoment& seen,
                           const BoxTrack& box);

/// Callback that receives each frame after it was scored, with its images. It may add
/// metrics.
using SeeFrame = std::function<void(ScoredFrame&)>;

/// Scored frames and their mean metrics.
struct Evaluation {
    std::string title = "rendered";  ///< what was scored
    std::vector<ScoredFrame> frames;
    MetricRow mean;
    MetricRow kernel_ms;    ///< mean time of a launch, by kernel
    double trace_ms = 0.0;  ///< mean time of a frame, including transfers
    double mrays_per_s = 0.0;
};

/// Copies the scans of the log into frames of a run that was trained on it. The poses of
/// the run are kept.
/// @param positions  indices into Run::sequence of the frames
/// @throws DataError if the log does not have a frame, or has it at another time
void attach_scans(Run& run, const std::vector<int>& positions, const Sequence& log);

/// Renders a frame at the pose of the real sensor and compares both images. With the
/// native grid, the rays are those of the real scan. With another grid, the simulated
/// points are binned in the same way as the real ones.
/// @param sequence  sequence of the renderer
/// @param frame  the frame, with its scan
/// @param sensor_offset  pose, in the frame of the log's sensor, of the sensor that made
/// frame.scan
ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                        const Frame& frame, const Pose& sensor_offset = {});

/// Renders and scores many frames. The memory does not grow with their number.
/// @param positions  indices of the frames in `sequence`
/// @param progress  called before each frame and after the last one; if it throws, the
/// evaluation stops
/// @param see  called for each scored frame
/// @throws DataError if a file with LPIPS weights is set and cannot be read
Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                           const std::vector<int>& positions, const Progress& progress = {},
                           const SeeFrame& see = {});

/// Computes the mean metrics of scored frames.
/// @param times  kernel times of the renderer that rendered the frames
Evaluation summarise(std::vector<ScoredFrame> frames, const KernelTimes& times);

/// Returns the mean time of a launch in milliseconds, by kernel.
MetricRow mean_times(const KernelTimes& times);

/// Returns how a baseline handles points in moving boxes. "nearest" leaves them where
/// they were measured; "nearest-actors" moves them with their boxes. Both baselines
/// consist of the points of the neighbouring training scans.
/// @param name  "nearest" or "nearest-actors"
/// @throws UsageError for another name
BoxMotion find_baseline(const std::string& name);
/// Scores a baseline on the held-out frames of a log.
/// @param name  see find_baseline()
/// @param sequence  the log, with its scans
/// @param progress  see evaluate_frames()
/// @param see  see evaluate_frames()
/// @throws UsageError like find_baseline()
Evaluation evaluate_baseline(const std::string& name, const Config& config, const Sequence& sequence,
                             const Split& split, const Progress& progress = {}, const SeeFrame& see = {});

/// Reads the file with LPIPS weights, if one is set. Detects a wrong file before a long
/// evaluation starts.
/// @throws DataError like read_lpips_weights()
void check_lpips_weights();
/// Returns the path of the file with LPIPS weights, from the environment variable
/// RELIDAR_LPIPS_WEIGHTS. If it is empty, LPIPS is not computed.
std::string lpips_weights_file();

}  // namespace relidar
