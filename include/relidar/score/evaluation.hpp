// SPDX-License-Identifier: Apache-2.0
// Rendered frames beside real ones, scored: a run on the frames it never saw, and the
// baseline that any rendering has to beat.
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

/// Rays that really returned, by how far away and how far off the rendered range is.
struct RangeErrorCounts {
    /// of the real range
    static constexpr std::array<double, 7> kRangeEdges_m{0.0, 10.0, 20.0, 30.0, 40.0, 60.0, 80.0};
    static constexpr std::array<double, 3> kErrorEdges_m{0.05, 0.2, 1.0};
    /// the last: the rendered ray does not return
    static constexpr std::size_t kBands = kErrorEdges_m.size() + 2;

    std::array<std::array<double, kBands>, kRangeEdges_m.size() - 1> rays{};
};

/// A frame rendered on the rays of the real one, and how close it came.
struct ScoredFrame {
    int frame = 0;  ///< the dataset's own number
    int lidar = 0;  ///< that took it
    double time_s = 0.0;
    std::optional<SweepStart> start = {};  ///< of the sweep, see Frame
    std::size_t n_rays = 0;                ///< traced; a grid of binned points has fewer pixels or more
    /// of an evaluation of many frames: of the middle one alone, of the others its time
    RenderedScan rendered;
    RangeImage real;  ///< likewise
    MetricRow metrics;
    RangeErrorCounts range_errors;
};

/// What a scan and its simulation have of somebody in a box.
struct PeoplePoints {
    /// [n,3] in the frame of the box, as it is when each is seen
    std::vector<glm::dvec3> real_m, simulated_m;
    /// rays that return from there: in both, in reality alone, simulated alone
    std::size_t n_both = 0, n_missed = 0, n_false = 0;
};

/// Points in a box grown by 0.1 m, the lowest 0.15 m left out, which are ground; for the
/// rays it is grown by 0.3 m.
/// @param rendered,real  of the same rays @param points_m [n] ranges of the simulated
/// points, see point_ranges()
/// @param box  that was observed then
PeoplePoints people_points(const RangeImage& rendered, const std::vector<float>& points_m,
                           const RangeImage& real, const Sequence& sequence, const SweepMoment& seen,
                           const BoxTrack& box);

/// Is given each frame once it is scored, with its images, and may add metrics.
using SeeFrame = std::function<void(ScoredFrame&)>;

/// Scored frames and what they are on average.
struct Evaluation {
    std::string title = "rendered";  ///< what was scored
    std::vector<ScoredFrame> frames;
    MetricRow mean;
    MetricRow kernel_ms;    ///< mean of one launch
    double trace_ms = 0.0;  ///< mean of one frame, with transfers
    double mrays_per_s = 0.0;
};

/// Gives frames of a run the scans of the log it was trained on. Poses stay those of the
/// run.
/// @param positions  of the frames, in Run::sequence
/// @throws DataError where the log has no such frame, or has it at another time
void attach_scans(Run& run, const std::vector<int>& positions, const Sequence& log);

/// Renders a frame at the place of the real sensor and compares. With the native grid the
/// rays are those of the real scan; a grid compares simulated points binned as the real
/// ones were.
/// @param sequence  of the renderer @param frame with its scan @param sensor_offset of
/// the sensor that made frame.scan
ScoredFrame score_frame(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                        const Frame& frame, const Pose& sensor_offset = {});

/// Scores frames of `sequence` by their positions in it. Memory does not grow with their
/// number.
/// @param progress  called before each frame and after the last; what it throws ends the
/// evaluation
/// @throws DataError where an LPIPS file is named and cannot be read
Evaluation evaluate_frames(ScanRenderer& renderer, const Config& config, const Sequence& sequence,
                           const std::vector<int>& positions, const Progress& progress = {},
                           const SeeFrame& see = {});

/// Means of scored frames. @param times of the renderer that made them
Evaluation summarise(std::vector<ScoredFrame> frames, const KernelTimes& times);

/// Mean milliseconds a launch, by kernel.
MetricRow mean_times(const KernelTimes& times);

/// The baselines: the neighbouring training scans, points in moving boxes left where they
/// are, or moved with their boxes.
/// @param name  "nearest" or "nearest-actors" @throws UsageError for another name
BoxMotion find_baseline(const std::string& name);
/// A baseline on the held-out frames of a log with its scans. @param progress, see  as
/// evaluate_frames() @throws as find_baseline()
Evaluation evaluate_baseline(const std::string& name, const Config& config, const Sequence& sequence,
                             const Split& split, const Progress& progress = {}, const SeeFrame& see = {});

/// Reads the weights of LPIPS, where some are named, to notice a wrong file before the
/// long work. @throws DataError as read_lpips_weights
void check_lpips_weights();
/// Path of the file with the weights of LPIPS, from the variable RELIDAR_LPIPS_WEIGHTS.
/// Empty: scores have no LPIPS.
std::string lpips_weights_file();

}  // namespace relidar
