// SPDX-License-Identifier: Apache-2.0
// Metrics that compare a rendered range image with a measured range image. docs/method.md
// section 8 defines the two protocols, "peer" and "strict". Also declares the baseline:
// neighbouring measured scans, moved to the pose of the sensor.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/classes.hpp>
#include <relidar/log/range_image.hpp>

namespace relidar {

struct Frame;
struct RayTable;
struct Scan;
struct Log;

/// Metric values by name. A name contains the protocol and the unit: "peer/depth_rmse_m",
/// "strict/cd_mean_m", "strict/drop_accuracy", ...
using MetricValues = std::map<std::string, double>;

class Lpips;

/// Options of the metrics. A pixel counts as returned if its drop probability is below
/// the threshold. Larger ranges than max_range_m are clamped.
struct MetricOptions {
    double peer_drop_threshold = 0.4;
    double strict_drop_threshold = double(kDropThreshold);
    double max_range_m = 80.0;
    const Lpips* lpips = nullptr;  ///< Null: the LPIPS metrics (peer/*_lpips) are not computed.
};

/// Pixels of a real image with separate metrics.
struct PixelRegion {
    /// For example, "moving_boxes" gives "moving_boxes/depth_medae_m".
    std::string name;
    std::vector<bool> pixels;  ///< [rows*columns] true for pixels in the region
    /// Also computes distances between the point clouds of the region. They are slow.
    bool scores_clouds = false;
};

/// Computes all metrics of a rendered image against the real image of the same rays.
///   peer/depth_{rmse_m,mae_m,medae_m,psnr_db,ssim,lpips}
///                         all pixels, 0 if dropped, clamped to [1e-6, max_range_m]
///   peer/intensity_{rmse,mae,medae,psnr_db,ssim,lpips}
///                         all pixels, 0 if dropped, clamped to [1e-6, 1]
///   peer/{cd_sq_m2,f_score}
///                         returned pixels; F-score at a squared distance of 0.05 m^2
///   strict/image_depth_*, strict/image_intensity_*
///                         like peer, with the strict drop threshold and without LPIPS
///   strict/depth_{rmse_m,mae_m,medae_m}, strict/intensity_{rmse,mae,medae}
///                         pixels that are returned in both images
///   strict/{cd_mean_m,cd_sq_m2}
///                         sum of the means of both directions
///   strict/{f_5cm,f_22cm} F-score at 0.05 m and sqrt(0.05) m
///   strict/drop_{accuracy,precision,recall,f1}
///                         positive = dropped
///   strict/drop_rmse      sqrt(mean (drop_prob - dropped)^2), all pixels, no threshold
/// A pixel counts as returned if drop_prob is below the threshold and range_m is above 0.
/// A metric that is undefined is left out. Examples: no pixel is returned, or the image
/// is below 7 x 7 pixels for SSIM or 31 x 31 for LPIPS. The F-score against an empty
/// cloud is 0.
/// @throws DataError if the images differ in shape or contain a value that is not finite
MetricValues evaluate(const RangeImage& rendered, const RangeImage& real, const MetricOptions& options = {});

/// Computes errors by region, over the pixels with a real return. The rendered values are
/// used even if the rendered pixel counts as dropped.
///   <region>/depth_{rmse_m,mae_m,medae_m}, <region>/intensity_{rmse,mae,medae}
///                       clamped as in evaluate()
///   <region>/returned   fraction of these pixels that also return in the rendered image,
///                       with the strict threshold
///   <region>/above_1m   fraction of the range errors above 1 m, over the pixels of the
///                       region that return in both images
///   <region>/pixels     number of these pixels; if 0, the other metrics are left out
///   <region>/share      this number, divided by the number of all real returns
///   <region>/{cd_mean_m,cd_sq_m2,f_5cm,f_22cm}
///                       like strict/, over the returned pixels of the region in both
///                       images; only if the region scores clouds
/// @throws DataError like evaluate(), and if a region has another number of pixels
MetricValues evaluate_regions(const RangeImage& rendered, const RangeImage& real,
                              const std::vector<PixelRegion>& regions, const MetricOptions& options = {});

/// Returns the sets of pixels that are scored separately: all, moving_boxes, static,
/// range_0_20_m, range_20_40_m, range_40_80_m. If the image has several rows, also edges
/// (mask_edges()) and smooth (all other pixels), with scores of their clouds.
/// @param moving_pixels [rows*columns] true for pixels whose return is in a moving box
std::vector<PixelRegion> make_regions(const RangeImage& real, const std::vector<bool>& moving_pixels);

/// Returns the pixels at depth edges. Their range differs from that of a neighbour in the
/// row or column by more than 0.5 m and more than 5 % of their range. Pixels without a
/// return are no neighbours. In a full turn, the first column follows the last one.
/// @return [rows*columns]
std::vector<bool> mask_edges(const RangeImage& real);

/// Returns for each ray whether its return is inside a moving box that the dataset
/// labelled.
/// @param sensor_offset  pose of the sensor that made the scan, in the frame of the log's
/// sensor
/// @return [n] rays
std::vector<bool> mask_labelled_movers(const Log& log, const Frame& frame, const Pose& sensor_offset = {});
/// Returns the same for moving boxes that relidar has found in the scans.
std::vector<bool> mask_found_movers(const Log& log, const Frame& frame, const Pose& sensor_offset = {});

/// Scores the points that are written to point cloud files, whose ranges can differ from
/// those of the image: strict/depth_*, strict/cd_* and strict/f_* of evaluate(), with
/// points/ instead of strict/.
/// @throws DataError like evaluate()
MetricValues evaluate_points(const RangeImage& rendered, const RangeImage& real,
                             const MetricOptions& options = {});

/// Compares the classes of rays with labels, over the rays whose label is not `unknown`.
///   classes/accuracy   fraction of these rays with equal classes
///   classes/mean_iou   mean over the labels that occur: rays that have the class in both
///                      scans, divided by the rays that have it in at least one scan
/// @param rendered [n] values of the channel `class`
/// @param real [n] labels
/// @return an empty row if no ray has a label
MetricValues score_classes(const std::vector<std::int32_t>& rendered, std::span<const SurfaceClass> real);

struct RangeImageComparison {
    const RangeImage* rendered = nullptr;
    const RangeImage* real = nullptr;
    std::vector<PixelRegion> regions;
    /// [rows*columns] ranges of the points of `rendered`; empty if points are not scored
    std::vector<float> point_range_m = {};
};
/// Calls evaluate() and evaluate_regions() for each frame, in parallel. If a comparison
/// has point ranges, scores regions with them and calls evaluate_points(), too.
/// @return [n] metrics of each comparison
std::vector<MetricValues> evaluate_all(const std::vector<RangeImageComparison>& images,
                                       const MetricOptions& options = {});

/// `stay`: points in moving boxes stay at their measured positions. `follow`: they move
/// with their boxes, and are left out if the box has left the scene.
enum class BoxPointMotion { stay, follow };

/// Predicts the points of a sweep from the nearest earlier and later training frames of
/// the same LiDAR. A point p_world is measured when the sensor faces it:
///   p_sensor = sensor_from_world(t) p_world,  t = facing_time_s(p_sensor)
/// The result is a list of rays that start at the sensor origin.
/// @param index  index of the sweep in log.frames; its scan is not read
/// @param train_frames  indices of the training frames, with their scans
/// @throws DataError if there is no training frame
Scan predict_scan(const Log& log, int index, const std::vector<int>& train_frames, BoxPointMotion motion);

/// Assigns each point to the ray with the smallest angle to the point. If several points
/// belong to a ray, the nearest point is kept. Skips points that are more than half a
/// beam spacing above the highest or below the lowest beam.
/// @return a scan of `rays`, with range_m along the direction of each ray
/// @throws DataError if the rays are not in image order
Scan assign_points(const RayTable& rays, const Scan& points);

/// Weights of LPIPS v0.1 with AlexNet. The convolutions have the shapes 64x3x11x11,
/// 192x64x5x5, 384x192x3x3, 256x384x3x3, 256x256x3x3 (out, in, height, width).
struct LpipsWeights {
    std::array<std::vector<float>, 5> weight;  ///< [out,in,height,width] of each convolution
    std::array<std::vector<float>, 5> bias;    ///< [out] of each convolution
    std::array<std::vector<float>, 5> linear;  ///< [out] weights of the channels of each convolution
};
/// Reads conv{0..4}.weight, conv{0..4}.bias and lin{0..4}.weight from a safetensors file,
/// in half or single precision. The constructor of Lpips checks the sizes.
/// @throws DataError if the file is damaged or an array is missing
LpipsWeights read_lpips_weights(const std::filesystem::path& path);

/// Learned perceptual distance between two images (Zhang et al., CVPR 2018), with AlexNet
/// features.
///   x' = (x - shift) / scale  for each colour
///   f_l = features after ReLU l, divided by (their norm over channels + 1e-10)
///   distance = sum over l of mean over pixels of
///              sum over channels of linear_l (f_l(a) - f_l(b))^2
class Lpips {
public:
    /// Checks and stores the weights.
    /// @throws DataError if an array has another size or a value that is not finite
    explicit Lpips(LpipsWeights weights);
    ~Lpips();
    /// @param first_image, second_image [3,rows,columns] values intended for -1..1, not
    /// clamped
    /// @return of the five layers
    /// @throws DataError if an array has another size, or the image is below 31 x 31
    /// pixels, so that pooling leaves no pixel
    std::array<double, 5> layer_distances(const std::vector<float>& first_image,
                                          const std::vector<float>& second_image, int rows,
                                          int columns) const;
    /// Returns the distance of two images with a single channel, summed over all layers.
    /// The channel becomes the three colours by x -> 2 x - 1, like `normalize` in the
    /// published code. This maps 0..1 to -1..1, and does not clamp larger values, such as
    /// ranges in metres.
    /// @param a, b [rows*columns]
    double compute_distance(const std::vector<double>& a, const std::vector<double>& b, int rows,
                            int columns) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Returns the structural similarity with the defaults of scikit-image: uniform 7 x 7
/// window, sample covariance, borders of 3 pixels cropped.
/// @param first_image, second_image [rows*columns]
/// @throws DataError if the image is below 7 x 7 pixels or data_range is not positive
double compute_ssim(const std::vector<double>& first_image, const std::vector<double>& second_image, int rows,
                    int columns, double data_range);

/// Returns the exact distance from each query point to the nearest target point. Uses all
/// cores.
/// @return [n] metres
/// @throws DataError if there is no target point or a coordinate is not finite
std::vector<double> nearest_distances_m(const std::vector<glm::dvec3>& from,
                                        const std::vector<glm::dvec3>& to);

/// Returns the mean of each metric. Rows that lack a metric do not affect its mean.
MetricValues mean_metrics(const std::vector<MetricValues>& metric_rows);

}  // namespace relidar
