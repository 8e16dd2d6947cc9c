// SPDX-License-Identifier: Apache-2.0
#include "read/bag/survey.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>

#include <fmt/format.h>

#include "base/geometry/circular_gap.hpp"
#include "base/median.hpp"

namespace relidar::bag {
namespace {

constexpr std::size_t kAzimuthSamples = 256, kAzimuthBins = 60;
// A wider cloud is a full revolution in which the vehicle blocks some directions.
constexpr double kWidestPart_rad = 300.0 * kPi / 180.0;
// If the clouds together leave a wider azimuth gap, the LiDAR does not rotate.
constexpr double kLeastGap_rad = kPi / 3.0;
// An azimuth step is the angle from the middle of a cloud to the middle of the next one.
// Clouds are slices of a revolution if their steps are about equal, |mean of
// exp(i step)| >= kMinStepAgreement, and about as wide as a cloud, |mean step - w| <=
// kMaxStepError * mean step. w is the median width of a cloud, or 2 pi minus this width
// if that is smaller.
constexpr double kMinStepAgreement = 0.8, kMaxStepError = 0.4;
// A cloud is missing if a time step exceeds this multiple of the usual step.
constexpr double kMinPauseSteps = 1.6;
constexpr double kDegreesPerRad = 180.0 / kPi;

/// Returns the bin of an azimuth. Bin 0 begins at -pi. The modulo moves +pi to bin 0.
std::size_t find_azimuth_bin(double azimuth_rad) {
    return std::size_t((azimuth_rad / (2.0 * kPi) + 0.5) * kAzimuthBins) % kAzimuthBins;
}

/// Returns the azimuth range that contains all points: the full circle except its widest
/// gap. Returns nothing if no bin has a point.
std::optional<AzimuthArc> find_arc(const std::array<bool, kAzimuthBins>& is_bin_occupied) {
    const CircularGap gap =
        find_widest_gap(kAzimuthBins, [&](std::size_t bin) { return is_bin_occupied[bin]; });
    if (gap.length >= kAzimuthBins) return std::nullopt;
    // The range begins where the gap ends, at the azimuth of bin gap.end. If the gap
    // passes bin 0, gap.end counts on, and remainder() removes the full turn.
    const double bin_rad = 2.0 * kPi / kAzimuthBins;
    const double begin_rad = bin_rad * double(gap.end) - kPi;
    const double extent_rad = 2.0 * kPi - bin_rad * double(gap.length);
    return AzimuthArc{.middle_rad = float(std::remainder(begin_rad + 0.5 * extent_rad, 2.0 * kPi)),
                      .extent_rad = float(extent_rad)};
}

/// Returns the widest sector of azimuths that no cloud covers. It is near 0 if the clouds
/// together are a full revolution.
double widest_gap_rad(const std::vector<CloudEntry>& clouds) {
    std::array<bool, kAzimuthBins> is_bin_occupied{};
    for (const CloudEntry& cloud : clouds)
        // Steps of 1 % of a cloud are below the 6 degrees of a bin, so no bin is missed.
        for (double share = -0.5; share <= 0.5; share += 0.01) {
            const double azimuth_rad = std::remainder(
                double(cloud.arc->middle_rad) + share * double(cloud.arc->extent_rad), 2.0 * kPi);
            is_bin_occupied[find_azimuth_bin(azimuth_rad)] = true;
        }
    const std::optional<AzimuthArc> all = find_arc(is_bin_occupied);
    return 2.0 * kPi - double(all ? all->extent_rad : 0.0f);
}

/// How a revolution is split into several clouds.
struct RevolutionPartition {
    double extent_rad;  ///< median azimuth width of a cloud
    double step_rad;    ///< mean azimuth step from cloud to cloud, without its direction
    /// Direction of rotation. Clockwise if clouds are half revolutions, because a step of
    /// half a turn is the same in both directions.
    bool is_clockwise;
    double step_s;
    /// Azimuth at which a revolution begins: the border between two clouds that is
    /// nearest to the rear of the LiDAR.
    double cut_rad;
};

/// Returns the border between two clouds that is nearest to the rear of the LiDAR.
/// @param n_parts  number of clouds in a revolution
double find_cut_rad(const std::vector<CloudEntry>& clouds, double n_parts) {
    // Middles differ by multiples of 2 pi / n. So n * middle is the same angle for all
    // clouds, and the sum of exp(i n middle) has this angle.
    std::complex<double> sum = 0.0;
    for (const CloudEntry& cloud : clouds) sum += std::polar(1.0, n_parts * double(cloud.arc->middle_rad));
    // A border is half a cloud, pi / n, after a middle. The other borders are whole
    // clouds away. The rear is at pi.
    const double border_rad = (std::arg(sum) + kPi) / n_parts, width_rad = 2.0 * kPi / n_parts;
    return border_rad + width_rad * std::round((kPi - border_rad) / width_rad);
}

/// Returns how the clouds of a topic divide a revolution, or nothing if they are full
/// revolutions or the LiDAR does not rotate.
std::optional<RevolutionPartition> estimate_split(const std::vector<CloudEntry>& clouds) {
    if (clouds.size() < 4) return std::nullopt;
    std::vector<float> extents_rad;
    std::vector<std::int64_t> steps_ns;
    // Sum of exp(i step). Its angle is the mean step, positive if the LiDAR rotates
    // counterclockwise. Its length is the number of steps if all are equal.
    std::complex<double> sum_of_steps = 0.0;
    for (std::size_t k = 0; k < clouds.size(); ++k) {
        extents_rad.push_back(clouds[k].arc->extent_rad);
        if (k == 0) continue;
        const CloudEntry &cloud = clouds[k], &before = clouds[k - 1];
        steps_ns.push_back(cloud.stamp_ns - before.stamp_ns);
        sum_of_steps += std::polar(1.0, double(cloud.arc->middle_rad) - double(before.arc->middle_rad));
    }
    const double extent_rad = compute_median(extents_rad), step_rad = std::abs(std::arg(sum_of_steps));
    const bool are_steps_equal = std::abs(sum_of_steps) >= kMinStepAgreement * double(steps_ns.size());
    if (extent_rad > kWidestPart_rad || !are_steps_equal) return std::nullopt;
    // In a rotating LiDAR, each cloud begins where the previous one ends, so the step is
    // the width. A step above half a turn, such as 240 degrees, looks like the smaller
    // step in the other direction, 120 degrees. So the width is changed in the same way.
    const double width_rad = std::min(extent_rad, 2.0 * kPi - extent_rad);
    const bool are_adjacent = std::abs(step_rad - width_rad) <= kMaxStepError * step_rad;
    if (!are_adjacent || widest_gap_rad(clouds) > kLeastGap_rad) return std::nullopt;
    const double n_parts = std::round(2.0 * kPi / step_rad);
    return RevolutionPartition{.extent_rad = extent_rad,
                               .step_rad = step_rad,
                               .is_clockwise = n_parts <= 2.0 || std::arg(sum_of_steps) < 0.0,
                               .step_s = 1e-9 * compute_median(steps_ns),
                               .cut_rad = find_cut_rad(clouds, n_parts)};
}

}  // namespace

std::optional<AzimuthArc> azimuth_arc(const read::PointTable& cloud) {
    const read::PointFieldView* x_field = cloud.find_field(read::PointAttribute::x);
    const read::PointFieldView* y_field = cloud.find_field(read::PointAttribute::y);
    if (!x_field || !y_field) return std::nullopt;
    std::array<bool, kAzimuthBins> is_bin_occupied{};
    const std::size_t n_samples = std::min(kAzimuthSamples, cloud.n);
    for (std::size_t k = 0; k < n_samples; ++k) {
        const std::size_t point = k * cloud.n / n_samples;  // evenly spread over the cloud
        const double x = (*x_field)[point], y = (*y_field)[point];
        const bool has_azimuth = std::isfinite(x) && std::isfinite(y) && (x != 0.0 || y != 0.0);
        if (has_azimuth) is_bin_occupied[find_azimuth_bin(std::atan2(y, x))] = true;
    }
    return find_arc(is_bin_occupied);
}

JoinedRevolutions join_clouds(std::vector<CloudEntry> clouds) {
    std::erase_if(clouds, [](const CloudEntry& cloud) { return !cloud.arc; });
    std::ranges::stable_sort(clouds, {}, &CloudEntry::stamp_ns);
    const std::optional<RevolutionPartition> split = estimate_split(clouds);
    JoinedRevolutions joined;
    if (!split) return joined;
    // rotation from the start of the revolution to the middle of a cloud, 0 to 2 pi
    const auto rotation_rad = [&](const CloudEntry& cloud) {
        const double direction = split->is_clockwise ? -1.0 : 1.0;
        const double angle_rad = direction * (double(cloud.arc->middle_rad) - split->cut_rad);
        return angle_rad - 2.0 * kPi * std::floor(angle_rad / (2.0 * kPi));
    };
    // The rotation increases until the revolution ends. It may also increase across a gap
    // in which the next one began, so a time step that is too long ends a revolution too.
    const auto begins_revolution = [&](const CloudEntry& cloud, const CloudEntry& before) {
        const double step_s = 1e-9 * double(cloud.stamp_ns - before.stamp_ns);
        return rotation_rad(cloud) <= rotation_rad(before) || step_s >= kMinPauseSteps * split->step_s;
    };
    std::vector<std::vector<CloudEntry>> revolutions;
    for (std::size_t k = 0; k < clouds.size(); ++k) {
        if (k == 0 || begins_revolution(clouds[k], clouds[k - 1])) revolutions.emplace_back();
        revolutions.back().push_back(clouds[k]);
    }
    // Incomplete revolutions have fewer clouds. 0.1 is a margin for rounding.
    const auto clouds_per_revolution = std::size_t(std::floor(2.0 * kPi / split->step_rad + 0.1));
    for (std::vector<CloudEntry>& revolution : revolutions) {
        if (revolution.size() >= clouds_per_revolution) joined.revolutions.push_back(std::move(revolution));
        else joined.n_left_out += revolution.size();
    }
    joined.note = fmt::format("each cloud covers only a part of a revolution, about {:.0f} degrees",
                              split->extent_rad * kDegreesPerRad);
    return joined;
}

}  // namespace relidar::bag
