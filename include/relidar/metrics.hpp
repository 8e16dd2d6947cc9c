// SPDX-License-Identifier: Apache-2.0
// How close a rendered range image is to a real one, under both protocols of docs/method.md section 8.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// A range image, real or rendered, with the ray of each pixel.
struct RangeImage {
    int rows = 0;
    int columns = 0;
    std::vector<float> range_m;        ///< [rows*columns] along the ray; 0 where dropped (real) or wherever nothing was met
    std::vector<float> intensity;      ///< [rows*columns]
    std::vector<float> drop_prob;      ///< [rows*columns] 0/1 for a real image
    std::vector<glm::vec3> origin;     ///< [rows*columns] metres, sensor frame
    std::vector<glm::vec3> direction;  ///< [rows*columns] unit, sensor frame
};

/// Metric name -> value. Names carry protocol and unit: "peer/depth_rmse_m", "strict/cd_mean_m", "strict/drop_accuracy", ...
using MetricRow = std::map<std::string, double>;

/// Which pixels count as returned in a rendering, and in what box ranges are compared.
struct MetricOptions {
    double peer_drop_threshold = 0.4;
    double strict_drop_threshold = 0.5;
    double max_range_m = 80.0;
};

/// All metrics of one rendering against the real image of the same rays.
///   peer/depth_{rmse_m,mae_m,medae_m,psnr_db,ssim}       every pixel, 0 where dropped, clamped to [1e-6, max_range_m]
///   peer/intensity_{rmse,mae,medae,psnr_db,ssim}         the same, clamped to [1e-6, 1]
///   peer/{cd_sq_m2,f_score}                              returned pixels; F-score at a squared distance of 0.05 m^2
///   strict/depth_{rmse_m,mae_m,medae_m}, strict/intensity_{rmse,mae,medae}   pixels returned in both
///   strict/{cd_mean_m,cd_sq_m2}                          sum of the two means (one a direction)
///   strict/{f_5cm,f_22cm}                                F-score at 0.05 m and sqrt(0.05) m
///   strict/drop_{accuracy,precision,recall,f1}           positive = dropped
/// A pixel counts as returned where drop_prob is below the threshold and range_m above 0. A metric that is undefined
/// (nothing returned, image below 7 x 7 for SSIM) is left out; an F-score against an empty cloud is 0.
/// @throws DataError where the images differ in shape or hold a value that is not finite
MetricRow evaluate(const RangeImage& rendered, const RangeImage& real, const MetricOptions& options = {});

/// Structural similarity, scikit-image's defaults: 7x7 uniform window, sample covariance, borders cropped by 3 pixels.
/// @param a,b [rows*columns] @throws DataError below 7 x 7 pixels or where data_range is not positive
double ssim(const std::vector<double>& a, const std::vector<double>& b, int rows, int columns, double data_range);

/// Distance from each query point to its nearest target point (exact, on all cores). @return [n] metres
/// @throws DataError where there is no target point or a coordinate is not finite
std::vector<double> nearest_distances(const std::vector<glm::dvec3>& query, const std::vector<glm::dvec3>& target);

/// Mean over frames, metric by metric, over the frames that have it.
MetricRow mean(const std::vector<MetricRow>& rows);

}  // namespace relidar
