// SPDX-License-Identifier: Apache-2.0
#include "read/bag/survey.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>

#include <fmt/format.h>

#include "base/median.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kAzimuthSamples = 256, kAzimuthBins = 60;
// A cloud with a wider azimuth range is a full revolution in which the vehicle blocks
// some directions.
constexpr double kMostOfPart = 300.0 * kPi / 180.0;
// If the clouds together leave a wider azimuth gap, the LiDAR does not rotate.
constexpr double kLeastGap_rad = kPi / 3.0;
// Clouds are slices of a revolution if their azimuth steps are about equal, |mean of
// exp(i step)| >= kMaxOverlap, and about as wide as a cloud, |mean step - w| <=
// kMaxAbutGap * mean step. w is the median width of a cloud, or 2 pi minus this width if
// that is smaller.
constexpr double kMaxOverlap = 0.8, kMaxAbutGap = 0.4;
// A part of a revolution is missing if a time step exceeds this multiple of the usual
// step.
constexpr double kMinPauseSteps = 1.6;
constexpr double kDegreesPerRad = 180.0 / kPi;

/// Returns the azimuth range that contains all points: the full circle except its widest
/// gap. Returns nothing if no bin has a point.
std::optional<AzimuthArc> find_arc(const std::array<bool, kAzimuthBins>& is_bin_occupied) {
    std::size_t widest = 0, end = 0, run = 0;
    // Loops over the circle twice, because its widest gap may contain the azimuth pi.
    for (std::size_t b = 0; b < 2 * kAzimuthBins; ++b) {
        run = is_bin_occupied[b % kAzimuthBins] ? 0 : run + 1;
        if (run > widest) {
            widest = run;
            end = b + 1;
        }
    }
    if (widest >= kAzimuthBins) return std::nullopt;
    const double bin = 2.0 * kPi / kAzimuthBins, extent = 2.0 * kPi - bin * double(widest);
    return AzimuthArc{float(std::remainder(bin * double(end) - kPi + 0.5 * extent, 2.0 * kPi)),
                      float(extent)};
}

/// Returns the widest sector of azimuths that no cloud covers. It is near 0 if the clouds
/// together are a full revolution.
double widest_gap_rad(const std::vector<RevolutionPart>& partial_clouds) {
    std::array<bool, kAzimuthBins> is_bin_occupied{};
    for (const RevolutionPart& cloud : partial_clouds)
        for (double a = -0.5; a <= 0.5; a += 0.01) {
            const double azimuth =
                std::remainder(double(cloud.arc.middle_rad) + a * double(cloud.arc.extent_rad), 2.0 * kPi);
            is_bin_occupied[std::size_t((azimuth / (2.0 * kPi) + 0.5) * kAzimuthBins) % kAzimuthBins] = true;
        }
    const std::optional<AzimuthArc> all = find_arc(is_bin_occupied);
    return 2.0 * kPi - double(all ? all->extent_rad : 0.0f);
}

/// How a revolution is split into several clouds.
struct RevolutionPartition {
    double extent_rad;  ///< median azimuth width of a cloud
    /// Mean azimuth step from cloud to cloud. Negative if the LiDAR rotates clockwise,
    /// and if clouds are half revolutions, because the direction is then unknown.
    double step_rad;
    double step_s;
    /// Azimuth at which a revolution begins: the border between two clouds that is
    /// nearest to the rear of the LiDAR.
    double cut_rad;
};

/// Returns how the clouds of a topic divide a revolution, or nothing if they are full
/// revolutions or the LiDAR does not rotate.
std::optional<RevolutionPartition> estimate_split(const std::vector<RevolutionPart>& partial_clouds) {
    if (partial_clouds.size() < 4) return std::nullopt;
    std::vector<float> extents;
    std::vector<std::int64_t> steps_ns;
    std::complex<double> sum = 0.0;
    for (std::size_t k = 0; k < partial_clouds.size(); ++k) {
        extents.push_back(partial_clouds[k].arc.extent_rad);
        if (k == 0) continue;
        steps_ns.push_back(partial_clouds[k].stamp_ns - partial_clouds[k - 1].stamp_ns);
        sum += std::polar(
            1.0, double(partial_clouds[k].arc.middle_rad) - double(partial_clouds[k - 1].arc.middle_rad));
    }
    const double extent = compute_median(extents), step = std::abs(std::arg(sum));
    if (extent > kMostOfPart || std::abs(sum) < kMaxOverlap * double(partial_clouds.size() - 1))
        return std::nullopt;
    if (std::abs(step - std::min(extent, 2.0 * kPi - extent)) > kMaxAbutGap * step ||
        widest_gap_rad(partial_clouds) > kLeastGap_rad)
        return std::nullopt;
    // Finds the common position of the clouds in a grid of n parts, as the phase of their
    // middle azimuths. Moves the border nearest to the rear (pi).
    const double n = std::round(2.0 * kPi / step);
    std::complex<double> phase = 0.0;
    for (const RevolutionPart& cloud : partial_clouds)
        phase += std::polar(1.0, n * double(cloud.arc.middle_rad));
    const double first_cut = (std::arg(phase) + kPi) / n, width = 2.0 * kPi / n;
    const double cut = first_cut + width * std::round((kPi - first_cut) / width);
    return RevolutionPartition{extent, n < 2.5 || std::arg(sum) < 0.0 ? -step : step,
                               1e-9 * compute_median(steps_ns), cut};
}

}  // namespace

std::optional<AzimuthArc> azimuth_arc(const read::PointTable& cloud) {
    const read::PointFieldView *x = cloud.find_field(read::PointAttribute::x),
                               *y = cloud.find_field(read::PointAttribute::y);
    if (!x || !y) return std::nullopt;
    std::array<bool, kAzimuthBins> is_bin_occupied{};
    const std::size_t n = std::min(kAzimuthSamples, cloud.n);
    for (std::size_t k = 0; k < n; ++k) {
        // Samples are evenly spread over the cloud.
        const std::size_t point = k * cloud.n / n;
        const double px = (*x)[point], py = (*y)[point];
        if (!std::isfinite(px) || !std::isfinite(py) || (px == 0.0 && py == 0.0)) continue;
        // Bin 0 begins at azimuth -pi. The modulo moves +pi to bin 0.
        is_bin_occupied[std::size_t((std::atan2(py, px) / (2.0 * kPi) + 0.5) * kAzimuthBins) % kAzimuthBins] =
            true;
    }
    return find_arc(is_bin_occupied);
}

JoinedRevolutions join_clouds(std::vector<RevolutionPart> partial_clouds) {
    std::ranges::stable_sort(partial_clouds, {}, &RevolutionPart::stamp_ns);
    const std::optional<RevolutionPartition> parts = estimate_split(partial_clouds);
    JoinedRevolutions joined;
    if (!parts) return joined;
    // rotation since the start of the revolution, 0 to 2 pi
    const auto turned = [&](const RevolutionPart& part) {
        const double angle =
            (parts->step_rad < 0.0 ? -1.0 : 1.0) * (double(part.arc.middle_rad) - parts->cut_rad);
        return angle - 2.0 * kPi * std::floor(angle / (2.0 * kPi));
    };
    std::vector<std::vector<RevolutionPart>> revolutions;
    for (std::size_t k = 0; k < partial_clouds.size(); ++k) {
        // A revolution also ends if a cloud is missing, because its time step is then too
        // long.
        const bool is_first = k == 0 || turned(partial_clouds[k]) <= turned(partial_clouds[k - 1]) ||
                              1e-9 * double(partial_clouds[k].stamp_ns - partial_clouds[k - 1].stamp_ns) >
                                  kMinPauseSteps * parts->step_s;
        if (is_first) revolutions.emplace_back();
        revolutions.back().push_back(partial_clouds[k]);
    }
    const auto clouds_per_revolution = std::size_t(std::floor(2.0 * kPi / std::abs(parts->step_rad) + 0.1));
    for (std::vector<RevolutionPart>& revolution : revolutions) {
        if (revolution.size() >= clouds_per_revolution) joined.revolutions.push_back(std::move(revolution));
        else joined.n_left_out += revolution.size();
    }
    joined.about = fmt::format("each cloud covers only a part of a revolution, about {:.0f} degrees",
                               parts->extent_rad * kDegreesPerRad);
    return joined;
}

}  // namespace relidar::bag
