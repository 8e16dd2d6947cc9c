// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/turn_parts.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <cstring>

#include <fmt/format.h>

namespace relidar::bag {
namespace {

constexpr std::size_t kSamples = 256, kBins = 60;
// Maximum azimuth range of a part of a revolution. A larger cloud is a full revolution in
// which the vehicle blocks some directions.
constexpr double kMostOfPart = 300.0 * kPi / 180.0;
// If no cloud has points in an azimuth range this large, the LiDAR scans a window and
// does not rotate.
constexpr double kLeastGap_rad = kPi / 3.0;
// Limits for the steps between clouds. kTogether: minimum length of the mean of the
// steps' unit vectors. kAbut: maximum difference between the step and the extent,
// relative to the step.
constexpr double kTogether = 0.8, kAbut = 0.4;
constexpr double kPause = 1.6;  // ratio to the usual time step above which a part is missing
constexpr double kDegrees = 180.0 / kPi;

/// Reads a field of a point and returns it as a number. Supports all types and both byte
/// orders.
double number_at(const Cloud& cloud, const Cloud::Field& field, std::size_t point) {
    const std::size_t row = point / cloud.width * (cloud.height > 1 ? cloud.row_step : 0);
    char raw[8] = {};
    std::memcpy(raw, cloud.data.data() + row + point % cloud.width * cloud.point_step + field.offset,
                field.size);
    if (cloud.is_big_endian) std::reverse(raw, raw + field.size);
    float narrow;
    double wide;
    std::memcpy(&narrow, raw, sizeof narrow);
    std::memcpy(&wide, raw, sizeof wide);
    return field.size == sizeof narrow ? double(narrow) : wide;
}

const Cloud::Field* find_real(const Cloud& cloud, const char* name) {
    const auto field = std::ranges::find(cloud.fields, name, &Cloud::Field::name);
    return field == cloud.fields.end() || field->kind != 'F' ? nullptr : &*field;
}

/// Returns the azimuth range that has points: everything except the widest range of empty
/// bins.
std::optional<Arc> arc_of_bins(const std::array<bool, kBins>& seen) {
    std::size_t widest = 0, end = 0, run = 0;
    for (std::size_t b = 0; b < 2 * kBins; ++b) {  // runs twice around, because a gap may cross the end
        run = seen[b % kBins] ? 0 : run + 1;
        if (run > widest) widest = run, end = b + 1;
    }
    if (widest >= kBins) return std::nullopt;
    const double bin = 2.0 * kPi / kBins, extent = 2.0 * kPi - bin * double(widest);
    return Arc{float(std::remainder(bin * double(end) - kPi + 0.5 * extent, 2.0 * kPi)), float(extent)};
}

double gap_of_all(const std::vector<TurnPart>& clouds) {
    std::array<bool, kBins> seen{};
    for (const TurnPart& cloud : clouds)
        for (double a = -0.5; a <= 0.5; a += 0.01) {
            const double azimuth =
                std::remainder(double(cloud.arc.middle_rad) + a * double(cloud.arc.extent_rad), 2.0 * kPi);
            seen[std::size_t((azimuth / (2.0 * kPi) + 0.5) * kBins) % kBins] = true;
        }
    const std::optional<Arc> all = arc_of_bins(seen);
    return 2.0 * kPi - double(all ? all->extent_rad : 0.0f);
}

template <class Value>
double median_of(std::vector<Value> values) {
    const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
    std::ranges::nth_element(values, middle);
    return double(*middle);
}

/// Typical extent and step of the parts of a revolution.
struct Parts {
    /// Median extent of a part, and mean step to the next part. A negative step means a
    /// clockwise rotation. It is also negative for halves, whose direction is unknown.
    double extent_rad, step_rad;
    double step_s;
    /// azimuth of the boundary between two parts at which revolutions begin, near the
    /// back
    double cut_rad;
};

std::optional<Parts> parts_of(const std::vector<TurnPart>& clouds) {
    if (clouds.size() < 4) return std::nullopt;
    std::vector<float> extents;
    std::vector<std::int64_t> steps_ns;
    std::complex<double> sum = 0.0;
    for (std::size_t k = 0; k < clouds.size(); ++k) {
        extents.push_back(clouds[k].arc.extent_rad);
        if (k == 0) continue;
        steps_ns.push_back(clouds[k].stamp_ns - clouds[k - 1].stamp_ns);
        sum += std::polar(1.0, double(clouds[k].arc.middle_rad) - double(clouds[k - 1].arc.middle_rad));
    }
    const double extent = median_of(extents), step = std::abs(std::arg(sum));
    if (extent > kMostOfPart || std::abs(sum) < kTogether * double(clouds.size() - 1)) return std::nullopt;
    if (std::abs(step - std::min(extent, 2.0 * kPi - extent)) > kAbut * step ||
        gap_of_all(clouds) > kLeastGap_rad)
        return std::nullopt;
    const double n = std::round(2.0 * kPi / step);
    std::complex<double> phase = 0.0;
    for (const TurnPart& cloud : clouds) phase += std::polar(1.0, n * double(cloud.arc.middle_rad));
    const double first_cut = (std::arg(phase) + kPi) / n, width = 2.0 * kPi / n;
    const double cut = first_cut + width * std::round((kPi - first_cut) / width);
    return Parts{extent, n < 2.5 || std::arg(sum) < 0.0 ? -step : step, 1e-9 * median_of(steps_ns), cut};
}

}  // namespace

std::optional<Arc> arc_of(const Cloud& cloud) {
    const Cloud::Field *x = find_real(cloud, "x"), *y = find_real(cloud, "y");
    if (!x || !y) return std::nullopt;
    std::array<bool, kBins> seen{};
    const std::size_t n = std::min(kSamples, cloud.size());
    for (std::size_t k = 0; k < n; ++k) {
        const std::size_t point = k * cloud.size() / n;
        const double px = number_at(cloud, *x, point), py = number_at(cloud, *y, point);
        if (!std::isfinite(px) || !std::isfinite(py) || (px == 0.0 && py == 0.0)) continue;
        seen[std::size_t((std::atan2(py, px) / (2.0 * kPi) + 0.5) * kBins) % kBins] = true;
    }
    return arc_of_bins(seen);
}

JoinedTurns join_turns(std::vector<TurnPart> clouds) {
    std::ranges::stable_sort(clouds, {}, &TurnPart::stamp_ns);
    const std::optional<Parts> parts = parts_of(clouds);
    JoinedTurns joined;
    if (!parts) return joined;
    const auto turned = [&](const TurnPart& part) {  // angle from the boundary to the part, 0 to 2 pi
        const double angle =
            (parts->step_rad < 0.0 ? -1.0 : 1.0) * (double(part.arc.middle_rad) - parts->cut_rad);
        return angle - 2.0 * kPi * std::floor(angle / (2.0 * kPi));
    };
    std::vector<std::vector<TurnPart>> turns;
    for (std::size_t k = 0; k < clouds.size(); ++k) {
        const bool is_first =
            k == 0 || turned(clouds[k]) <= turned(clouds[k - 1]) ||
            1e-9 * double(clouds[k].stamp_ns - clouds[k - 1].stamp_ns) > kPause * parts->step_s;
        if (is_first) turns.emplace_back();
        turns.back().push_back(clouds[k]);
    }
    const auto n_whole = std::size_t(std::floor(2.0 * kPi / std::abs(parts->step_rad) + 0.1));
    for (std::vector<TurnPart>& turn : turns) {
        if (turn.size() >= n_whole) joined.turns.push_back(std::move(turn));
        else joined.n_left_out += turn.size();
    }
    joined.about = fmt::format("each cloud is a part of a turn, about {:.0f} degrees of it",
                               parts->extent_rad * kDegrees);
    return joined;
}

}  // namespace relidar::bag
