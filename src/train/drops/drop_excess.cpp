// SPDX-License-Identifier: Apache-2.0
#include "train/drops/drop_excess.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "base/sigmoid.hpp"

namespace relidar {
namespace {

constexpr int kNeighbourBins = 2;   // bins on each side that are summed
constexpr double kPriorRays = 8.0;  // virtual rays that stabilise the rate of a bin with few rays
constexpr double kSignificance = 3.0, kMinVariance = 1.0;
constexpr double kMinRate = 0.5;  // lower rates can be errors of the regression
// An ignored bin returns at most 5 % of its rays in the log. A scene that returns more
// contradicts the log.
constexpr double kMinContradiction = 0.05;
constexpr std::size_t kMaxFittedRays = 200000;  // more do not change the regression

using Features = Eigen::Matrix<double, 4, 1>;

/// The power of a return is proportional to intensity / range^2, so a drop depends on the
/// logarithms of both. The drop logit is what the surfels have learnt.
Features features_of(const CheckedRay& ray) {
    constexpr double kLeastIntensity = 0.005, kLeastRange_m = 0.1, kMaxLogit = 8.0;
    return {1.0, std::clamp(double(ray.drop_logit), -kMaxLogit, kMaxLogit),
            std::log(std::max(kLeastRange_m, double(ray.range_m))),
            std::log(std::max(kLeastIntensity, double(ray.intensity)))};
}

/// Returns the coefficients with which the logistic regression explains the drops of the
/// rays in bins whose `rate` is 0. Newton's method, from the given coefficients.
Features fit_drops(std::span<const CheckedRay> rays, const std::vector<float>& rate, Features coefficients) {
    constexpr int kSteps = 12;
    constexpr double kRidge = 1.0;  // limits coefficients that no ray determines
    const std::size_t stride = 1 + rays.size() / kMaxFittedRays;
    for (int step = 0; step < kSteps; ++step) {
        Eigen::Matrix<double, 4, 4> curvature = kRidge * Eigen::Matrix<double, 4, 4>::Identity();
        Features slope = -kRidge * coefficients;
        for (std::size_t i = 0; i < rays.size(); i += stride) {
            if (rate[rays[i].bin] > 0.0f || rays[i].is_ignored) continue;
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
    double n = 0.0, drops = 0.0;
    double returns = 0.0;                           ///< sum of 1 - q
    double variance = 0.0;                          ///< sum of q (1 - q)
    double n_ignored = 0.0, ignored_returns = 0.0;  ///< n and sum of 1 - q of ignored rays

    double excess() const { return drops - (n - returns); }
    void add(const BinSums& other) {
        n += other.n;
        drops += other.drops;
        returns += other.returns;
        variance += other.variance;
        n_ignored += other.n_ignored;
        ignored_returns += other.ignored_returns;
    }
};

std::vector<BinSums> sum_bins(std::span<const CheckedRay> rays, std::size_t n_bins,
                              const Features& coefficients) {
    std::vector<BinSums> sums(n_bins);
    for (const CheckedRay& ray : rays) {
        const double q = ray.is_met ? sigmoid(coefficients.dot(features_of(ray))) : 1.0;
        BinSums& sum = sums[ray.bin];
        sum.n += 1.0;
        sum.drops += ray.is_dropped ? 1.0 : 0.0;
        sum.returns += 1.0 - q;
        sum.variance += q * (1.0 - q);
        if (!ray.is_ignored) continue;
        sum.n_ignored += 1.0;
        sum.ignored_returns += 1.0 - q;
    }
    return sums;
}

/// Returns the rate p of a bin of a beam, as find_drop_excess() defines it.
float bin_rate(std::span<const BinSums> beam, int bin) {
    BinSums sum = {}, local = {};
    for (int offset = -kNeighbourBins; offset <= kNeighbourBins; ++offset) {
        const int n_bins = int(beam.size());
        const BinSums& neighbour = beam[std::size_t((bin + offset + n_bins) % n_bins)];
        if (offset == 0) sum = neighbour;
        local.add(neighbour);
    }
    if (local.excess() > kSignificance * std::sqrt(kMinVariance + local.variance)) {
        const double rate = local.excess() / (kPriorRays + local.returns),
                     p = (sum.excess() + kPriorRays * rate) / (sum.returns + kPriorRays);
        if (p >= kMinRate) return float(std::min(p, 1.0));
    }
    const bool is_contradicted = local.ignored_returns >= kMinContradiction * local.n_ignored;
    return sum.n_ignored > 0.0 && is_contradicted ? float(sum.drops / sum.n) : 0.0f;
}

}  // namespace

RayDropTable find_drop_excess(const RayDropTable& bins, std::span<const CheckedRay> rays) {
    constexpr int kRounds = 3;  // blocked rays that one round finds are no part of the next fit
    RayDropTable table = bins;
    table.probability.assign(std::size_t(bins.channels) * std::size_t(bins.bins), 0.0f);
    Features coefficients = Features::Zero();
    for (int round = 0; round < kRounds; ++round) {
        coefficients = fit_drops(rays, table.probability, coefficients);
        const std::vector<BinSums> sums = sum_bins(rays, table.probability.size(), coefficients);
        const std::size_t n = std::size_t(bins.bins);
        for (std::size_t i = 0; i < sums.size(); ++i)
            table.probability[i] = bin_rate(std::span(sums).subspan(i / n * n, n), int(i % n));
    }
    return table;
}

}  // namespace relidar
