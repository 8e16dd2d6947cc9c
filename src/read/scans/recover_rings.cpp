// SPDX-License-Identifier: Apache-2.0
// Determines the rings of points without ring numbers. A beam draws a cone when the head
// rotates. Seen from the centre of the sensor, all far points of a beam have nearly the
// same elevation. So a histogram has narrow bands of beams, with empty bins in between.
#include <relidar/read/clouds.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include <relidar/base/error.hpp>

#include "log/sensor/beam_geometry.hpp"

namespace relidar {
namespace {

// Bin width of the histogram of elevations. Real beams are at least ten bins apart.
constexpr double kBinWidth_rad = 0.01 * kPi / 180.0;
constexpr int kLeastGap = 3;  // minimum number of empty bins between two bands
constexpr std::size_t kFewestBands = 4;
// Maximum width of the points of a beam, relative to the distance of the next beam.
constexpr double kMaxBandWidth = 0.5;
// A bin counts as empty below this share of a well-filled bin (90th percentile).
constexpr double kMinBinShare = 0.005;
// A near point can have the elevation of another beam, because beams start beside the
// origin. It is compared with this many beams above and below.
constexpr std::ptrdiff_t kBeamReach = 6;

double compute_elevation(const glm::dvec3& vector) {
    return std::atan2(vector.z, std::hypot(vector.x, vector.y));
}

/// Returns elevations of points in ascending order. Leaves out the nearer half of the
/// points in each degree, because beams start beside the sensor origin.
std::vector<double> collect_elevations(const std::vector<LidarPoints>& scans) {
    struct PointRangeElevation {
        float range_m;
        double elevation_rad;
    };
    constexpr std::size_t kDegrees = 180;  // from straight down to straight up
    std::vector<std::vector<PointRangeElevation>> points_by_degree(kDegrees + 1);
    for (const LidarPoints& scan : scans)
        for (const glm::vec3& p : scan.position_m) {
            const double elevation_rad = compute_elevation(glm::dvec3(p));
            const auto degree = std::size_t((elevation_rad / kPi + 0.5) * double(kDegrees));
            points_by_degree[degree].push_back({glm::length(p), elevation_rad});
        }
    std::vector<double> elevations_rad;
    for (std::vector<PointRangeElevation>& points : points_by_degree) {
        const auto first_far = points.begin() + std::ptrdiff_t(points.size() / 2);
        std::ranges::nth_element(points, first_far, {}, &PointRangeElevation::range_m);
        for (auto point = first_far; point != points.end(); ++point)
            elevations_rad.push_back(point->elevation_rad);
    }
    std::ranges::sort(elevations_rad);
    return elevations_rad;
}

/// Returns the bin of the histogram of elevations. Bin 0 begins at -90 degrees.
int bin_of(double elevation_rad) { return int((elevation_rad + kPi / 2) / kBinWidth_rad); }

/// Consecutive bins of the histogram of elevations that contain the points of one beam.
struct RingBand {
    int first, last;             ///< first and last bin
    double elevation_rad = 0.0;  ///< median elevation of the points in the band

    bool contains(const RingBand& other) const { return other.first >= first && other.last <= last; }
};

/// Groups consecutive bins that have points, at least `min_points_per_bin`. Two groups
/// are separated by at least kLeastGap other bins.
std::vector<RingBand> group_bins(const std::vector<int>& points_per_bin, double min_points_per_bin) {
    std::vector<RingBand> bands;
    for (int b = 0; b < int(points_per_bin.size()); ++b) {
        const int n_points = points_per_bin[std::size_t(b)];
        if (n_points == 0 || n_points < min_points_per_bin) continue;
        if (bands.empty() || b - bands.back().last > kLeastGap) bands.push_back({b, b});
        bands.back().last = b;
    }
    return bands;
}

/// Returns the distance between the centres of two bands, in bins.
double band_distance(const RingBand& first, const RingBand& second) {
    return 0.5 * std::abs(double(second.first + second.last) - double(first.first + first.last));
}

/// Adds weak bands: narrow bands with few points, which belong to beams with few returns.
/// Unlike stray points, a weak band continues the spacing of the two bands before it.
/// @param candidate_bands  groups of all bins with points, upward or downward
/// @param strong_bands  bands whose bins have enough points, in the same order. Each is a
/// part of one candidate, which can be wider because of stray points.
std::vector<RingBand> add_weak_bands(const std::vector<RingBand>& candidate_bands,
                                     const std::vector<RingBand>& strong_bands) {
    constexpr double kMinStepRatio = 0.75, kMaxStepRatio = 1.35;  // distances, relative to the spacing
    constexpr int kWidestWeak = 2;                                // in bins
    std::vector<RingBand> complete;
    // Distance between the last two bands, which predicts the next band. Not set before
    // the second band, nor after stray points.
    std::optional<double> spacing;
    const auto add = [&](const RingBand& band) {
        if (!complete.empty()) spacing = band_distance(complete.back(), band);
        complete.push_back(band);
    };
    auto strong = strong_bands.begin();  // next strong band
    for (const RingBand& candidate : candidate_bands) {
        // A candidate with strong bands contributes only these.
        const auto first_strong = strong;
        for (; strong != strong_bands.end() && candidate.contains(*strong); ++strong) add(*strong);
        if (strong != first_strong || !spacing) continue;
        const double distance = band_distance(complete.back(), candidate);
        const bool continues_spacing =
            distance > kMinStepRatio * *spacing && distance < kMaxStepRatio * *spacing;
        const bool is_narrow = candidate.last - candidate.first <= kWidestWeak;
        const bool leaves_space =
            strong == strong_bands.end() || band_distance(candidate, *strong) > kMinStepRatio * *spacing;
        if (continues_spacing && is_narrow && leaves_space) add(candidate);
        else spacing.reset();
    }
    return complete;
}

/// Returns the number of points that a bin of a strong band must have.
double find_least_count(std::vector<int> points_per_bin) {
    std::erase(points_per_bin, 0);  // empty bins
    const auto well_filled = points_per_bin.begin() + std::ptrdiff_t(points_per_bin.size() * 9 / 10);
    std::ranges::nth_element(points_per_bin, well_filled);
    return kMinBinShare * *well_filled;
}

/// Sets the elevation of each band to the median elevation of its points.
void set_elevations(std::vector<RingBand>& bands, const std::vector<double>& sorted_elevations_rad) {
    for (RingBand& band : bands) {
        const auto begin = std::ranges::partition_point(
            sorted_elevations_rad, [&](double elevation_rad) { return bin_of(elevation_rad) < band.first; });
        const auto end = std::partition_point(begin, sorted_elevations_rad.end(), [&](double elevation_rad) {
            return bin_of(elevation_rad) <= band.last;
        });
        band.elevation_rad = *(begin + (end - begin) / 2);
    }
}

/// Returns the bands in the histogram of elevations, from the lowest to the highest beam:
/// strong bands, whose bins have many points, and weak bands, which have few points but
/// continue the regular distances of strong bands.
std::vector<RingBand> find_bands(const std::vector<double>& sorted_elevations_rad) {
    if (sorted_elevations_rad.empty()) return {};
    std::vector<int> points_per_bin(std::size_t(bin_of(kPi / 2)) + 2, 0);
    for (const double elevation_rad : sorted_elevations_rad)
        ++points_per_bin[std::size_t(bin_of(elevation_rad))];

    std::vector<RingBand> candidates = group_bins(points_per_bin, 1.0);  // of all bins with points
    const std::vector<RingBand> strong = group_bins(points_per_bin, find_least_count(points_per_bin));
    // A pass continues distances only in its direction: upward, then downward.
    std::vector<RingBand> bands = add_weak_bands(candidates, strong);
    std::ranges::reverse(candidates);
    std::ranges::reverse(bands);
    bands = add_weak_bands(candidates, bands);
    std::ranges::reverse(bands);
    set_elevations(bands, sorted_elevations_rad);
    return bands;
}

/// Returns the beam whose elevation fits a point best, seen from the origin of the beam.
/// Tests only beams near the elevation that the point has from the sensor origin.
/// @param rising  indices of the beams in ascending order of elevation
/// @param rays  [beams] origin and direction of each beam
std::uint16_t find_beam(const glm::dvec3& point_m, const std::vector<Beam>& beams,
                        const std::vector<std::uint16_t>& rising, const std::vector<BeamRays>& rays) {
    const double elevation_rad = compute_elevation(point_m);
    const auto nearest = std::ranges::partition_point(
        rising, [&](std::uint16_t beam) { return beams[beam].elevation_rad < elevation_rad; });
    const auto begin = nearest - std::min(kBeamReach, nearest - rising.begin());
    const auto end = nearest + std::min(kBeamReach, rising.end() - nearest);
    std::uint16_t best = *begin;
    double least_error_rad = INFINITY;
    for (auto beam = begin; beam != end; ++beam) {
        const glm::dvec3 origin_m = rays[*beam].compute_ray(rays[*beam].azimuth_facing(point_m)).origin_m;
        const double error_rad = std::abs(compute_elevation(point_m - origin_m) - beams[*beam].elevation_rad);
        if (error_rad < least_error_rad) {
            least_error_rad = error_rad;
            best = *beam;
        }
    }
    return best;
}

}  // namespace

std::vector<Beam> estimate_beams(const std::vector<LidarPoints>& scans) {
    const std::vector<RingBand> bands = find_bands(collect_elevations(scans));
    if (bands.size() < kFewestBands) return {};
    // Bands of beams are narrow compared with their distance from the next band.
    for (std::size_t i = 0; i + 1 < bands.size(); ++i) {
        const double n_bins = (bands[i + 1].elevation_rad - bands[i].elevation_rad) / kBinWidth_rad;
        for (const RingBand& band : {bands[i], bands[i + 1]})
            if (band.last - band.first > kMaxBandWidth * n_bins) return {};
    }
    std::vector<Beam> beams;
    for (auto band = bands.rbegin(); band != bands.rend(); ++band)
        beams.push_back({.elevation_rad = band->elevation_rad});
    return beams;
}

void assign_rings(LidarPoints& points, const std::vector<Beam>& beams) {
    if (beams.empty() || beams.size() > kNoBeam)
        throw UsageError(
            "cannot compute the rings of points: the sensor has no beams or too many beams, expected 1 to "
            "65535 beams");
    std::vector<std::uint16_t> rising(beams.size());
    std::iota(rising.begin(), rising.end(), std::uint16_t(0));
    std::ranges::stable_sort(rising, {}, [&](std::uint16_t beam) { return beams[beam].elevation_rad; });
    const std::vector<BeamRays> rays = make_generators(beams);
    points.ring.clear();
    for (const glm::vec3& point : points.position_m)
        points.ring.push_back(find_beam(glm::dvec3(point), beams, rising, rays));
}

}  // namespace relidar
