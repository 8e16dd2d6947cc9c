// SPDX-License-Identifier: Apache-2.0
#include "simulate/render/footprint.hpp"

#include <cmath>
#include <numeric>

#include "simulate/channels/channel_pairs.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

// Minimum intensity of a sub-ray when its power is computed. Without it, a group of black
// sub-rays would have a power of 0, which cannot weight means.
constexpr float kMinIntensity = 1e-3f;

struct SubRayHit {
    std::size_t index = 0;  ///< of the sub-ray in its scan
    float range_m = 0.0f;
    glm::dvec2 offset{0.0};  ///< of the sub-ray from the axis of the beam, see spread_sub_rays()
    double power = 1.0;      ///< received power as by power_of(), if the sub-ray were a beam
};
struct SubRayReturn {
    std::vector<SubRayHit> parts;  ///< sorted by range
    double power = 0.0;            ///< sum over the parts
};

/// Returns true if at least five sub-rays hit the same plane. Fits 1 / range by least
/// squares, because on a plane it is a linear function of the sub-ray offsets. Three
/// sub-rays always fit a plane, so a test needs more.
/// @param tolerance_m maximum distance of a hit from the plane along its ray
bool is_coplanar(const std::vector<SubRayHit>& hits, double tolerance_m) {
    if (hits.size() < 5) return false;
    // Solves the normal equations of 1 / range = plane . (1, offset x, offset y).
    glm::dmat3 normal_matrix(0.0);
    glm::dvec3 right_side(0.0);
    const auto row = [](const SubRayHit& hit) { return glm::dvec3(1.0, hit.offset.x, hit.offset.y); };
    for (const SubRayHit& hit : hits) {
        normal_matrix += glm::outerProduct(row(hit), row(hit));
        right_side += row(hit) / double(hit.range_m);
    }
    // Sub-rays whose offsets lie on a line do not define a plane.
    if (std::abs(glm::determinant(normal_matrix)) < 1e-9) return false;
    const glm::dvec3 plane = glm::inverse(normal_matrix) * right_side;
    return std::ranges::all_of(hits, [&](const SubRayHit& hit) {
        const double inverse_m = glm::dot(plane, row(hit));
        return inverse_m > 0.0 && std::abs(1.0 / inverse_m - double(hit.range_m)) < tolerance_m;
    });
}

/// Joins consecutive groups of sub-rays that hit the same plane. A plane at a grazing
/// angle, such as a distant road, spans many ranges but gives only one return.
/// @param groups groups of one beam, sorted by range
void join_coplanar(std::vector<SubRayReturn>& groups, double tolerance_m) {
    // Tries all groups of the beam first, then shorter and shorter sequences, so that a
    // plane becomes one group instead of several.
    for (std::size_t length = groups.size(); length >= 2; --length) {
        for (std::size_t begin = 0; begin + length <= groups.size(); ++begin) {
            SubRayReturn joined;
            for (std::size_t g = begin; g < begin + length; ++g) {
                joined.parts.insert(joined.parts.end(), groups[g].parts.begin(), groups[g].parts.end());
                joined.power += groups[g].power;
            }
            if (!is_coplanar(joined.parts, tolerance_m)) continue;
            groups[begin] = std::move(joined);
            groups.erase(groups.begin() + std::ptrdiff_t(begin) + 1,
                         groups.begin() + std::ptrdiff_t(begin + length));
        }
    }
}

/// Divides the returned sub-rays of a beam into groups that form one return each: either
/// without a gap of `separation_m` between their sorted ranges, or on the same plane.
/// @param first index of the first sub-ray of the beam
std::vector<SubRayReturn> group_sub_rays(const RenderedScan& scan, std::size_t first,
                                         const std::vector<glm::dvec2>& offsets, float separation_m,
                                         const IntensityResponse& response) {
    std::vector<SubRayHit> hits;
    for (std::size_t k = 0; k < offsets.size(); ++k) {
        const std::size_t i = first + k;
        const float range_m = scan.median_range_m[i];
        if (!is_ray_returned(scan.image.drop_prob[i], range_m)) continue;
        const LidarEcho echo =
            surface_echo(range_m, std::max(scan.image.intensity[i], kMinIntensity), response);
        hits.push_back({i, range_m, offsets[k], power_of(echo)});
    }
    std::ranges::stable_sort(hits, {}, &SubRayHit::range_m);
    std::vector<SubRayReturn> groups;
    for (const SubRayHit& hit : hits) {
        if (groups.empty() || hit.range_m - groups.back().parts.back().range_m >= separation_m)
            groups.emplace_back();
        groups.back().parts.push_back(hit);
        groups.back().power += hit.power;
    }
    join_coplanar(groups, 0.5 * double(separation_m));
    return groups;
}

/// Returns the mean of `values` over a group, weighted by the received power.
float weighted_mean(const SubRayReturn& group, const std::vector<float>& values) {
    double sum = 0.0;
    for (const SubRayHit& hit : group.parts) sum += hit.power * double(values[hit.index]);
    return static_cast<float>(sum / group.power);
}

float sum_over_group(const SubRayReturn& group, const std::vector<float>& values) {
    float sum = 0.0f;
    for (const SubRayHit& hit : group.parts) sum += values[hit.index];
    return sum;
}

/// Joins the sub-rays of each beam to one ray with up to two returns.
class SubRayMerger {
public:
    SubRayMerger(const RenderedScan& parts, const RayTable& rays, const SensorConfig& config,
                 const IntensityResponse& response, const WeatherSensorProperties& sensor)
        : parts_(parts),
          response_(response),
          sensor_(sensor),
          offsets_(spread_sub_rays(config.sub_rays)),
          config_(config),
          scan_(empty_scan(rays, parts)) {
        if (config.returns == 2) scan_.second_returns.resize(1);
    }

    /// Appends a beam to the joined scan. ChannelMergeRule says how each channel combines
    /// the values of the sub-rays.
    void append_beam(std::size_t beam) {
        const int n = config_.sub_rays;
        const std::size_t first = beam * std::size_t(n);
        const std::vector<SubRayReturn> groups = group_sub_rays(
            parts_, first, offsets_, static_cast<float>(config_.return_separation_m), response_);
        // If no sub-ray returns, the beam gets the values of its central sub-ray.
        const SubRayReturn middle{{{.index = first}}, 1.0};
        const SubRayReturn& strongest =
            groups.empty() ? middle : *std::ranges::max_element(groups, {}, &SubRayReturn::power);
        // The surface at the joined range gives the instance and the other values.
        const float joined_m = weighted_mean(strongest, parts_.median_range_m);
        const auto distance_to_joined = [&](const SubRayHit& hit) {
            // Of equal ranges, the part nearest to the centre is used. Parts are ordered
            // from the centre outwards.
            return std::pair(std::abs(parts_.median_range_m[hit.index] - joined_m), hit.index);
        };
        const std::size_t nearest = std::ranges::min_element(strongest.parts, {}, distance_to_joined)->index;
        const auto append_joined = [&]<class T>(const ChannelInfo& channel, const std::vector<T>& of_parts,
                                                std::vector<T>& of_rays) {
            T value = of_parts[nearest];
            if constexpr (std::is_same_v<T, float>) {
                const auto begin = of_parts.begin() + std::ptrdiff_t(first);
                if (channel.join == ChannelMergeRule::range) value = weighted_mean(strongest, of_parts);
                if (channel.join == ChannelMergeRule::drop)
                    value = std::accumulate(begin, begin + n, 0.0f) / float(n);
                if (channel.join == ChannelMergeRule::intensity && !groups.empty())
                    value = sum_over_group(strongest, of_parts) / float(n);
            }
            of_rays.push_back(value);
        };
        for_all_channels(parts_, scan_, append_joined);
        if (!scan_.second_returns.empty()) append_second(groups, strongest);
    }

    RenderedScan joined_scan() { return std::move(scan_); }

private:
    const RenderedScan& parts_;
    const IntensityResponse& response_;
    const WeatherSensorProperties& sensor_;
    const std::vector<glm::dvec2> offsets_;
    const SensorConfig& config_;
    RenderedScan scan_;

    bool is_detected(const SubRayReturn& group) const {
        const double range_m = weighted_mean(group, parts_.median_range_m);
        return group.power / config_.sub_rays >= sensor_.min_power_at(range_m);
    }

    /// Returns the group that is the second return of a beam: the last one, or the second
    /// strongest if the last is the strongest. Ignores groups that the sensor does not
    /// detect. Returns null if no group remains.
    /// @param groups groups of the beam, sorted by range
    const SubRayReturn* find_second(const std::vector<SubRayReturn>& groups,
                                    const SubRayReturn& strongest) const {
        const SubRayReturn* second = nullptr;
        for (const SubRayReturn& group : groups) {
            if (&group == &strongest || !is_detected(group)) continue;
            const bool is_behind = &group > &strongest;
            if (!second || is_behind || group.power > second->power) second = &group;
        }
        return second;
    }

    /// Appends the second return of the beam that was appended last, or 0 if it has none.
    void append_second(const std::vector<SubRayReturn>& groups, const SubRayReturn& strongest) {
        const bool returns = is_ray_returned(scan_.image.drop_prob.back(), scan_.median_range_m.back());
        const SubRayReturn* second = returns ? find_second(groups, strongest) : nullptr;
        const auto n = static_cast<float>(config_.sub_rays);
        AdditionalReturns& returned = scan_.second_returns[0];
        returned.range_m.push_back(second ? weighted_mean(*second, parts_.median_range_m) : 0.0f);
        returned.intensity.push_back(second ? sum_over_group(*second, parts_.image.intensity) / n : 0.0f);
    }
};

}  // namespace

RayTable split_rays(const RayTable& rays, int sub_rays_per_ray, double divergence_rad) {
    const std::vector<glm::dvec2> offsets = spread_sub_rays(sub_rays_per_ray);
    RayTable parts;
    parts.rows = rays.rows;
    parts.columns = rays.columns * sub_rays_per_ray;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const glm::dvec3 direction(rays.direction[i]);
        // `left` and `up` are unit vectors, perpendicular to the ray and to each other.
        // `helper` is any axis that is not nearly parallel to the ray.
        const glm::dvec3 helper = std::abs(direction.z) < 0.9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0);
        const glm::dvec3 left = glm::normalize(glm::cross(helper, direction));
        const glm::dvec3 up = glm::cross(direction, left);
        const double half_rad = 0.5 * (divergence_rad > 0.0 ? divergence_rad : rays.divergence_of_rad(i));
        for (const glm::dvec2& offset : offsets) {
            const glm::dvec2 angle = half_rad * offset;
            parts.origin.push_back(rays.origin[i]);
            parts.direction.emplace_back(
                glm::normalize(direction + std::tan(angle.x) * left + std::tan(angle.y) * up));
            parts.time_offset_s.push_back(rays.time_offset_s[i]);
            parts.channel.push_back(rays.channel[i]);
        }
    }
    return parts;
}

RenderedScan join_sub_rays(const RenderedScan& parts, const RayTable& beams, const SensorConfig& config,
                           const IntensityResponse& response, const WeatherSensorProperties& sensor) {
    SubRayMerger joiner(parts, beams, config, response, sensor);
    for (std::size_t ray = 0; ray < beams.size(); ++ray) joiner.append_beam(ray);
    return joiner.joined_scan();
}

RayIndices find_edge_beams(const RenderedScan& parts, const RayTable& beams, const SensorConfig& config) {
    const std::vector<glm::dvec2> offsets = spread_sub_rays(config.sub_rays);
    const auto separation_m = static_cast<float>(config.return_separation_m);
    RayIndices edges;
    for (std::size_t beam = 0; beam < beams.size(); ++beam) {
        const std::size_t first = beam * offsets.size();  // the sub-rays of a beam are consecutive
        if (group_sub_rays(parts, first, offsets, separation_m, {}).size() > 1) edges.push_back(beam);
    }
    return edges;
}

void replace_rays(RenderedScan& scan, const RayIndices& rays, const RenderedScan& replacement) {
    const auto replace = [&](const auto& from, auto& to) {
        for (std::size_t i = 0; i < rays.size(); ++i) to[rays[i]] = from[i];
    };
    for_all_channels(replacement, scan,
                     [&](const ChannelInfo&, const auto& from, auto& to) { replace(from, to); });
    for (std::size_t k = 0; k < scan.second_returns.size(); ++k) {
        replace(replacement.second_returns[k].range_m, scan.second_returns[k].range_m);
        replace(replacement.second_returns[k].intensity, scan.second_returns[k].intensity);
    }
    scan.trace_ms += replacement.trace_ms;
}

}  // namespace relidar
