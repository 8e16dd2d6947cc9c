// SPDX-License-Identifier: Apache-2.0
#include "train/drops/drop_excess.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "base/sigmoid.hpp"

namespace relidar {
namespace {

constexpr int kNeighbourBins = 2;   // bins on each side over which the local excess is summed
constexpr double kPriorRays = 8.0;  // virtual rays that stabilise the rate of a bin with few rays
constexpr double kSignificance = 3.0, kMinVariance = 1.0;
constexpr double kMinRate = 0.5;                // lower rates can be errors of the regression
constexpr std::size_t kMaxFittedRays = 200000;  // more do not change the regression

using Features = Eigen::Matrix<double, 4, 1>;

/// The power of a return is proportional to intensity / range^2, so a drop depends on the
/// logarithms of both. The drop logit is what the surfels have learnt.
Features features_of(const SolidRay& ray) {
    constexpr double kLeastIntensity = 0.005, kLeastRange_m = 0.1, kMaxLogit = 8.0;
    return {1.0, std::clamp(double(ray.drop_logit), -kMaxLogit, kMaxLogit),
            std::log(std::max(kLeastRange_m, double(ray.range_m))),
            std::log(std::max(kLeastIntensity, double(ray.intensity)))};
}

/// Returns the coefficients with which the logistic regression explains the drops of the
/// rays in bins whose `rate` is 0. Newton's method, from the given coefficients.
Features fit_drops(std::span<const SolidRay> rays, const std::vector<float>& rate, Features coefficients) {
    constexpr int kSteps = 12;
    constexpr double kRidge = 1.0;  // limits coefficients that no ray determines
    const std::size_t stride = 1 + rays.size() / kMaxFittedRays;
    for (int step = 0; step < kSteps; ++step) {
        Eigen::Matrix<double, 4, 4> curvature = kRidge * Eigen::Matrix<double, 4, 4>::Identity();
        Features slope = Features::Zero();
        for (std::size_t i = 0; i < rays.size(); i += stride) {
            if (rate[rays[i].bin] > 0.0f) continue;
            const Features features = features_of(rays[i]);
            const double q = sigmoid(coefficients.dot(features));
            slope += ((rays[i].is_dropped ? 1.0 : 0.0) - q) * features;
            curvature += q * (1.0 - q) * features * features.transpose();
        }
        coefficients += curvature.ldlt().solve(slope);
    }
    return coefficients;
}

/// Sums over the rays of a bin, with the drop probability q of the scene.
struct BinSums {
    double excess = 0.0;    ///< drops - sum of q
    double returns = 0.0;   ///< sum of 1 - q
    double variance = 0.0;  ///< sum of q (1 - q)
};

std::vector<BinSums> sum_bins(std::span<const SolidRay> rays, std::size_t n_bins,
                              const Features& coefficients) {
    std::vector<BinSums> sums(n_bins);
    for (const SolidRay& ray : rays) {
        const double q = sigmoid(coefficients.dot(features_of(ray)));
        sums[ray.bin].excess += (ray.is_dropped ? 1.0 : 0.0) - q;
        sums[ray.bin].returns += 1.0 - q;
        sums[ray.bin].variance += q * (1.0 - q);
    }
    return sums;
}

/// Returns the rate of a bin and its neighbours together, or 0 if it is not significant.
double local_rate(std::span<const BinSums> beam, int bin) {
    const int n_bins = int(beam.size());
    BinSums sum{.returns = kPriorRays, .variance = kMinVariance};
    for (int b = bin - kNeighbourBins; b <= bin + kNeighbourBins; ++b) {
        const BinSums& neighbour = beam[std::size_t((b + n_bins) % n_bins)];
        sum.excess += neighbour.excess;
        sum.returns += neighbour.returns;
        sum.variance += neighbour.variance;
    }
    return sum.excess > kSignificance * std::sqrt(sum.variance) ? sum.excess / sum.returns : 0.0;
}

}  // namespace

RayDropTable find_drop_excess(const RayDropTable& bins, std::span<const SolidRay> rays) {
    constexpr int kRounds = 3;  // blocked rays that one round finds are no part of the next fit
    RayDropTable table = bins;
    table.probability.assign(std::size_t(bins.channels) * std::size_t(bins.bins), 0.0f);
    Features coefficients = Features::Zero();
    for (int round = 0; round < kRounds; ++round) {
        coefficients = fit_drops(rays, table.probability, coefficients);
        const std::vector<BinSums> sums = sum_bins(rays, table.probability.size(), coefficients);
        for (std::size_t i = 0; i < sums.size(); ++i) {
            const std::size_t beam = i / std::size_t(bins.bins), first = beam * std::size_t(bins.bins);
            const double rate =
                local_rate(std::span(sums).subspan(first, std::size_t(bins.bins)), int(i - first));
            const double p = (sums[i].excess + kPriorRays * rate) / (sums[i].returns + kPriorRays);
            table.probability[i] = rate > 0.0 && p >= kMinRate ? float(std::min(p, 1.0)) : 0.0f;
        }
    }
    return table;
}

}  // namespace relidar
