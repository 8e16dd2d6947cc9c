// SPDX-License-Identifier: Apache-2.0
// Determines the rings of points without ring numbers. A beam draws a cone when the head
// rotates. Seen from the centre of the sensor, all far points of a beam have nearly the
// same elevation. So a histogram of the elevations has one narrow band per beam. The bins
// between bands are empty.
#include <relidar/read/clouds.hpp>

#include <algorithm>
#include <cmath>
#include <numeric>

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

/// Returns elevations of points in ascending order. Uses only the farther half of the
/// points in each degree. Near points are less accurate, because beams start beside the
/// sensor origin.
std::vector<double> collect_elevations(const std::vector<LidarPoints>& scans) {
    struct PointRangeElevation {
        float range_m;
        double elevation_rad;
    };
    std::vector<std::vector<PointRangeElevation>> samples_by_degree(181);  // points by degree of elevation
    for (const LidarPoints& scan : scans)
        for (const glm::vec3& p : scan.position_m) {
            const double elevation = compute_elevation(glm::dvec3(p));
            samples_by_degree[std::size_t((elevation / kPi + 0.5) * 180.0)].push_back(
                {glm::length(p), elevation});
        }
    std::vector<double> elevations;
    for (std::vector<PointRangeElevation>& degree : samples_by_degree) {
        const auto half = degree.begin() + std::ptrdiff_t(degree.size() / 2);
        std::nth_element(degree.begin(), half, degree.end(),
                         [](const PointRangeElevation& first, const PointRangeElevation& second) {
                             return first.range_m < second.range_m;
                         });
        for (auto s = half; s != degree.end(); ++s) elevations.push_back(s->elevation_rad);
    }
    std::sort(elevations.begin(), elevations.end());
    return elevations;
}

struct RingBand {
    int first, last;       ///< first and last bin
    double elevation_rad;  ///< median elevation of the band
};

/// Groups consecutive bins that have at least `min_points_per_bin` points. At least
/// kLeastGap empty bins separate two groups.
std::vector<RingBand> group_bins(const std::vector<int>& points_per_bin, double min_points_per_bin) {
    std::vector<RingBand> bands;
    for (int b = 0; b < int(points_per_bin.size()); ++b) {
        if (points_per_bin[std::size_t(b)] == 0 || points_per_bin[std::size_t(b)] < min_points_per_bin)
            continue;
        if (bands.empty() || b - bands.back().last > kLeastGap) bands.push_back({b, b, 0.0});
        bands.back().last = b;
    }
    return bands;
}

/// Adds narrow bands with few points, which belong to beams with few returns. Their
/// distance from the previous band must be similar to the last distance between two
/// bands, unlike that of stray points.
/// @param candidate_bands  groups of all bins with points, in the order of the search
/// @param strong_bands  bands with enough points, in the same order
std::vector<RingBand> add_weak_bands(const std::vector<RingBand>& candidate_bands,
                                     const std::vector<RingBand>& strong_bands) {
    constexpr double kMinStepRatio = 0.75, kMaxStepRatio = 1.35;  // distances, relative to the usual distance
    constexpr int kWidestWeak = 2;
    std::vector<RingBand> complete;
    double usual = 0.0;       // distance between the last two bands
    bool is_regular = false;  // false after a group of stray points, until the next accepted band
    const auto distance = [](const RingBand& first, const RingBand& second) {
        return 0.5 * std::abs(double(second.first + second.last) - double(first.first + first.last));
    };
    const auto add = [&](const RingBand& band) {
        if (!complete.empty()) usual = distance(complete.back(), band);
        is_regular = complete.size() > 0;
        complete.push_back(band);
    };
    std::size_t next = 0;
    for (const RingBand& group : candidate_bands) {
        const std::size_t first = next;
        while (next < strong_bands.size() && strong_bands[next].first >= group.first &&
               strong_bands[next].last <= group.last)
            add(strong_bands[next++]);
        if (next > first || !is_regular) continue;
        const double apart = distance(complete.back(), group);
        is_regular =
            apart > kMinStepRatio * usual && apart < kMaxStepRatio * usual &&
            group.last - group.first <= kWidestWeak &&
            (next == strong_bands.size() || distance(group, strong_bands[next]) > kMinStepRatio * usual);
        if (is_regular) add(group);
    }
    return complete;
}

/// Returns the bands in the histogram of elevations. A band is a group of filled bins and
/// contains the points of one beam.
std::vector<RingBand> find_bands(const std::vector<double>& sorted_elevations_rad) {
    const int n_bins = int(kPi / kBinWidth_rad) + 1;
    const auto bin = [](double elevation) { return int((elevation + kPi / 2) / kBinWidth_rad); };
    std::vector<int> count(std::size_t(n_bins) + 1, 0);
    for (const double e : sorted_elevations_rad) ++count[std::size_t(bin(e))];
    std::vector<int> full;
    std::copy_if(count.begin(), count.end(), std::back_inserter(full), [](int c) { return c > 0; });
    if (full.empty()) return {};
    std::nth_element(full.begin(), full.begin() + std::ptrdiff_t(full.size() * 9 / 10), full.end());
    const double least = kMinBinShare * full[full.size() * 9 / 10];
    std::vector<RingBand> groups = group_bins(count, 1.0), bands = group_bins(count, least);
    for (int pass = 0; pass < 2; ++pass) {  // upward, then downward
        bands = add_weak_bands(groups, bands);
        std::ranges::reverse(groups);
        std::ranges::reverse(bands);
    }
    for (RingBand& band : bands) {
        const auto begin = std::partition_point(sorted_elevations_rad.begin(), sorted_elevations_rad.end(),
                                                [&](double e) { return bin(e) < band.first; });
        const auto end = std::partition_point(begin, sorted_elevations_rad.end(),
                                              [&](double e) { return bin(e) <= band.last; });
        band.elevation_rad = *(begin + (end - begin) / 2);
    }
    return bands;
}

}  // namespace

std::vector<Beam> estimate_beams(const std::vector<LidarPoints>& scans) {
    const std::vector<RingBand> bands = find_bands(collect_elevations(scans));
    if (bands.size() < kFewestBands) return {};
    // Every band must be narrow compared with its distance from the next band. Otherwise
    // the bands are not beams.
    for (std::size_t i = 0; i + 1 < bands.size(); ++i) {
        const double apart = (bands[i + 1].elevation_rad - bands[i].elevation_rad) / kBinWidth_rad;
        for (const RingBand& band : {bands[i], bands[i + 1]})
            if (band.last - band.first > kMaxBandWidth * apart) return {};
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
    const auto elevation = [&](std::uint16_t index) { return beams[index].elevation_rad; };
    std::stable_sort(rising.begin(), rising.end(),
                     [&](auto first, auto second) { return elevation(first) < elevation(second); });
    const std::vector<BeamRays> geometry = make_generators(beams);
    points.ring.clear();
    for (const glm::vec3& point : points.position_m) {
        const glm::dvec3 p(point);
        const double point_elevation_rad = compute_elevation(p);
        // Compares only beams near the elevation of the point, seen from the sensor
        // origin. The elevation from the origin of the beam then decides.
        const auto nearest = std::partition_point(rising.begin(), rising.end(),
                                                  [&](auto k) { return elevation(k) < point_elevation_rad; });
        const auto begin = nearest - std::min(kBeamReach, nearest - rising.begin()),
                   end = nearest + std::min(kBeamReach, rising.end() - nearest);
        std::uint16_t best = *begin;
        double least = INFINITY;
        for (auto k = begin; k != end; ++k) {
            const glm::dvec3 origin = geometry[*k].compute_ray(geometry[*k].azimuth_facing(p)).origin_m;
            const double miss = std::abs(compute_elevation(p - origin) - elevation(*k));
            if (miss < least) {
                least = miss;
                best = *k;
            }
        }
        points.ring.push_back(best);
    }
}

}  // namespace relidar
