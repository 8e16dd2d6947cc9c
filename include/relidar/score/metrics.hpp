// SPDX-License-Identifier: Apache-2.0
// How close a rendered range image is to a real one, under both protocols of
// docs/method.md section 8; by region; and the baseline every rendering has to beat: the
// neighbouring real scans, moved.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/range_image.hpp>

namespace relidar {

struct Frame;
struct RayTable;
struct Scan;
struct Sequence;

/// Metric name -> value. Names carry protocol and unit: "peer/depth_rmse_m",
/// "strict/cd_mean_m", "strict/drop_accuracy", ...
using MetricRow = std::map<std::string, double>;

class Lpips;

/// Which pixels count as returned in a rendering, and in what box ranges are compared.
struct MetricOptions {
    double peer_drop_threshold = 0.4;
    double strict_drop_threshold = double(kDropThreshold);
    double max_range_m = 80.0;
    const Lpips* lpips = nullptr;  ///< nothing: peer/*_lpips is left out
};

/// Pixels of a real image that are scored apart.
struct Region {
    std::string name;  ///< "moving_boxes": names of its metrics are "moving_boxes/depth_medae_m" and so on
    std::vector<bool> pixels;  ///< [rows*columns]
};

/// All metrics of one rendering against the real image of the same rays.
///   peer/depth_{rmse_m,mae_m,medae_m,psnr_db,ssim,lpips}  every pixel, 0 where dropped, clamped to [1e-6, max_range_m]
///   peer/intensity_{rmse,mae,medae,psnr_db,ssim,lpips}    the same, clamped to [1e-6, 1]
///   peer/{cd_sq_m2,f_score}                              returned pixels; F-score at a squared distance of 0.05 m^2
///   strict/image_depth_*, strict/image_intensity_*       images as peer's, dropped by the strict threshold; no LPIPS
///   strict/depth_{rmse_m,mae_m,medae_m}, strict/intensity_{rmse,mae,medae}   pixels returned in both
///   strict/{cd_mean_m,cd_sq_m2}                          sum of the two means (one a direction)
///   strict/{f_5cm,f_22cm}                                F-score at 0.05 m and sqrt(0.05) m
///   strict/drop_{accuracy,precision,recall,f1}           positive = dropped
///   strict/drop_rmse                                     sqrt(mean (drop_prob - dropped)^2), every pixel, no threshold
/// A pixel counts as returned where drop_prob is below the threshold and range_m above 0.
/// A metric that is undefined (nothing returned, image below 7 x 7 for SSIM or 31 x 31
/// for LPIPS) is left out; an F-score against an empty cloud is 0.
/// @throws DataError where the images differ in shape or hold a value that is not finite
MetricRow evaluate(const RangeImage& rendered, const RangeImage& real, const MetricOptions& options = {});

/// Errors by region, over its pixels with a real return; the rendered value as it is,
/// whatever its drop probability:
///   <region>/depth_{rmse_m,mae_m,medae_m}, <region>/intensity_{rmse,mae,medae}   clamped as in evaluate()
///   <region>/returned   share of these pixels that also return in the rendering, by the strict threshold
///   <region>/pixels     how many there are; the other metrics are left out where there is none
/// @throws DataError as evaluate(), and where a region has another number of pixels
MetricRow evaluate_regions(const RangeImage& rendered, const RangeImage& real,
                           const std::vector<Region>& regions, const MetricOptions& options = {});

/// The regions users ask for: all, moving_boxes, static, and the bands range_0_20_m,
/// range_20_40_m, range_40_80_m.
/// @param moving [rows*columns] pixels whose return lies in a moving box
std::vector<Region> standard_regions(const RangeImage& real, const std::vector<bool>& moving);

/// Which returns of a scan lie in a box that moves. @return [n] rays
/// @param sensor_offset of the sensor that made the scan from the log's own
std::vector<bool> moving_returns(const Sequence& sequence, const Frame& frame,
                                 const Pose& sensor_offset = {});
/// Same for boxes that were discovered without a label.
std::vector<bool> discovered_returns(const Sequence& sequence, const Frame& frame,
                                     const Pose& sensor_offset = {});

/// How close points are, as the strict protocol has it: points/{depth_*,cd_*,f_*}, of the
/// clouds that files hold, whose ranges may be other than those of the image. @throws
/// DataError as evaluate()
MetricRow evaluate_points(const RangeImage& rendered, const RangeImage& real,
                          const MetricOptions& options = {});

/// One rendering, the real image beside it and its regions.
struct Comparison {
    const RangeImage* rendered = nullptr;
    const RangeImage* real = nullptr;
    std::vector<Region> regions;
    std::vector<float> point_range_m = {};  ///< [rows*columns] of the points of `rendered`, or empty
};
/// evaluate(), evaluate_regions() and, where a comparison has points, evaluate_points()
/// of many frames at once, on all cores. @return [n] rows
std::vector<MetricRow> evaluate_all(const std::vector<Comparison>& comparisons,
                                    const MetricOptions& options = {});

/// What the baseline does with points in moving boxes.
// where the poses put them; or moved with their boxes, left out where the box is gone
enum class BoxMotion { stay, follow };

/// The trivial baseline: returns of the nearest earlier and later training frame, moved
/// into another sweep of the sensor, each as it would be seen when the head faces it. Not
/// an image yet: one ray a point, from the sensor's origin.
///   p_sensor(t) = sensor_from_world(t) p_world,  t = facing_time(p_sensor)
/// @param position      of the sweep in sequence.frames; its own scan is not read
/// @param train         positions of training frames, with their scans
/// @throws DataError where there is no training frame
Scan neighbour_points(const Sequence& sequence, int position, const std::vector<int>& train, BoxMotion boxes);

/// Bins points into a ray table: each point goes to the ray that passes it at the
/// smallest angle, the nearest point wins a ray. Points above the highest or below the
/// lowest beam by more than half a beam spacing are left out.
/// @return a scan of `rays`, range_m along each ray's own direction @throws DataError for
/// rays without image order
Scan bin_onto_rays(const RayTable& rays, const Scan& points);

/// Weights of LPIPS v0.1, AlexNet. Convolution l is 64x3x11x11, 192x64x5x5, 384x192x3x3,
/// 256x384x3x3, 256x256x3x3 (out, in, height, width).
struct LpipsWeights {
    std::array<std::vector<float>, 5> weight;  ///< [out,in,height,width]
    std::array<std::vector<float>, 5> bias;    ///< [out]
    std::array<std::vector<float>, 5> linear;  ///< [out] of each convolution's channels
};
/// Weights of LPIPS: arrays conv{0..4}.weight, conv{0..4}.bias, lin{0..4}.weight of a
/// safetensors file, half or single precision.
/// @throws DataError for a file that is damaged or lacks one; Lpips checks their sizes
LpipsWeights read_lpips_weights(const std::filesystem::path& path);

/// Learned perceptual distance of two images (Zhang et al., CVPR 2018), AlexNet features.
///   x' = (x - shift) / scale by colour;  f_l = features after ReLU l, divided by their norm over channels + 1e-10
///   distance = sum over l of the mean over pixels of sum over channels of linear_l (f_l(a) - f_l(b))^2
class Lpips {
public:
    /// @throws DataError where an array has another size or is not finite
    explicit Lpips(LpipsWeights weights);
    ~Lpips();
    /// Distance by layer. @param a,b [3,rows,columns], meant for -1..1; other values are
    /// taken as they are
    /// @throws DataError below 31 x 31 pixels, where no pixel is left after the poolings,
    /// and for other sizes
    std::array<double, 5> by_layer(const std::vector<float>& a, const std::vector<float>& b, int rows,
                                   int columns) const;
    /// Their sum, of one channel repeated three times and taken from 0..1 to -1..1 as the
    /// published code's `normalize` does: x -> 2 x - 1, without a clamp. Published LiDAR
    /// tables pass metres. @param a,b [rows*columns]
    double distance(const std::vector<double>& a, const std::vector<double>& b, int rows, int columns) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Structural similarity, scikit-image's defaults: 7x7 uniform window, sample covariance,
/// borders cropped by 3 pixels.
/// @param a,b [rows*columns] @throws DataError below 7 x 7 pixels or where data_range is
/// not positive
double ssim(const std::vector<double>& a, const std::vector<double>& b, int rows, int columns,
            double data_range);

/// Distance from each query point to its nearest target point (exact, on all cores).
/// @return [n] metres
/// @throws DataError where there is no target point or a coordinate is not finite
std::vector<double> nearest_distances(const std::vector<glm::dvec3>& query,
                                      const std::vector<glm::dvec3>& target);

/// Mean over frames, metric by metric, over the frames that have it.
MetricRow mean(const std::vector<MetricRow>& rows);

}  // namespace relidar
