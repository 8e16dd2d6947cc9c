// SPDX-License-Identifier: Apache-2.0
#include "scene/point_surfels.hpp"

#include <optional>
#include <unordered_set>

#include <Eigen/Eigenvalues>
#include <nanoflann.hpp>

#include "base/progress_blocks.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

using Neighbours = std::vector<std::size_t>;  // indices of samples

constexpr float kSh0 = 0.28209479177387814f;  ///< SH constant of degree 0
/// SH constant of degree 1; the three functions multiply it by -y, z and -x
constexpr double kSh1 = 0.4886025119029199;
constexpr int kScaleNeighbours = 3;
/// A gap between scan lines is wider than this multiple of the mean distance to the
/// nearest points. Gaps between randomly distributed points are narrower.
constexpr double kMinGapRatio = 2.5;

struct SampleKdTreeAdapter {
    const LidarSamples& samples;
    std::size_t kdtree_get_point_count() const { return samples.size(); }
    float kdtree_get_pt(std::size_t index, std::size_t axis) const {
        return samples[index].position[static_cast<int>(axis)];
    }
    bool kdtree_get_bbox(auto&) const { return false; }
};
using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, SampleKdTreeAdapter>,
                                                 SampleKdTreeAdapter, 3, std::size_t>;

struct NeighbourPlane {
    glm::dvec3 point{0.0}, normal{0.0};
    bool is_line = false;  ///< true if the points spread along one axis only
    /// true if the points lie in a plane: the spread along the third axis is less than
    /// options.flatness times the spread along the second axis
    bool is_surface = false;
};

/// Fits a plane to neighbouring points. The normal is the axis along which the points
/// spread least. If all points lie on one scan line, the normal is the one that faces the
/// sensor most. If the points form no surface, the normal points to the sensor, because
/// rays of the next scan would miss a surfel that is edge-on.
/// @param direction unit vector from the sensor to the surface
/// @param flatness see NeighbourPlane::is_surface
NeighbourPlane fit_neighbours(const LidarSamples& samples, const Neighbours& neighbours,
                              const glm::dvec3& direction, double flatness) {
    constexpr double kMaxLineWidth = 0.02;  // variance across a line / variance along it
    const auto position = [&](std::size_t j) {
        return Eigen::Vector3d(samples[j].position.x, samples[j].position.y, samples[j].position.z);
    };
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const std::size_t j : neighbours) mean += position(j);
    mean /= double(neighbours.size());
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const std::size_t j : neighbours) {
        const Eigen::Vector3d d = position(j) - mean;
        covariance += d * d.transpose();
    }
    // The eigenvectors are the axes of the spread, sorted by ascending variance.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Vector3d& variance = solver.eigenvalues();
    const Eigen::Matrix3d& axes = solver.eigenvectors();
    const bool is_line = variance[1] < kMaxLineWidth * variance[2];
    const bool is_single_position = !(variance[2] > 0.0);
    const bool is_surface = !is_line && variance[0] < flatness * variance[1];
    glm::dvec3 normal(axes(0, 0), axes(1, 0), axes(2, 0));
    if (is_line && !is_single_position) {
        // Removes the part of the view direction that is parallel to the line.
        const glm::dvec3 line(axes(0, 2), axes(1, 2), axes(2, 2));
        normal = -direction + glm::dot(direction, line) * line;
    } else if (!is_surface) {
        normal = -direction;
    }
    const double length = glm::length(normal);
    return {.point = {mean.x(), mean.y(), mean.z()},
            .normal = length > 1e-9 ? normal / length : -direction,
            .is_line = is_line,
            .is_surface = is_surface};
}

/// Returns a unit vector perpendicular to a normal, rotated about the normal by an angle.
glm::dvec3 perpendicular_at(const glm::dvec3& normal, double angle_rad) {
    const glm::dvec3 helper = std::abs(normal.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0);
    const glm::dvec3 x = glm::normalize(glm::cross(helper, normal));
    return std::cos(angle_rad) * x + std::sin(angle_rad) * glm::cross(normal, x);
}

/// Neighbouring scan lines of a point on a surface, left and right of its own line.
struct ScanLineGap {
    glm::dvec3 across{0.0};  ///< unit vector to the right, perpendicular to the scan line
    /// distance to each of the two lines; empty if no point shows it
    std::optional<double> left_m{}, right_m{};

    bool is_line_missing() const { return !left_m || !right_m; }
};

/// Returns the unit vector in a surface that is perpendicular to the scan line through a
/// point. Averages the directions to the nearest points, which lie on the scan line.
/// Doubles their angles, because opposite directions mean the same line.
/// @param neighbours sorted by distance; the first is the point itself
glm::dvec3 find_across_line(const LidarSamples& samples, const Neighbours& neighbours,
                            const glm::dvec3& normal) {
    constexpr std::size_t kOnLine = 4;  // neighbours that lie on the same scan line as the point
    const glm::dvec3 point(samples[neighbours[0]].position);
    // axes of the surface, in which angles are measured from x
    const glm::dvec3 x = perpendicular_at(normal, 0.0), y = glm::cross(normal, x);
    double cosine_sum = 0.0, sine_sum = 0.0;  // of the doubled angles
    for (std::size_t j = 1; j < std::min(neighbours.size(), kOnLine + 1); ++j) {
        const glm::dvec3 offset = glm::dvec3(samples[neighbours[j]].position) - point;
        const double u = glm::dot(offset, x), v = glm::dot(offset, y),
                     length2 = std::max(u * u + v * v, 1e-12);
        // cos 2a = cos^2 a - sin^2 a, sin 2a = 2 sin a cos a
        cosine_sum += (u * u - v * v) / length2;
        sine_sum += 2.0 * u * v / length2;
    }
    const double line_angle_rad = 0.5 * std::atan2(sine_sum, cosine_sum);
    return perpendicular_at(normal, line_angle_rad + 0.5 * kPi);
}

/// Measures the distance from a point to the next scan line on each side: to the nearest
/// point in the plane of the surface that lies across the scan line.
/// @param neighbours sorted by distance; the first is the point itself
ScanLineGap measure_gap(const LidarSamples& samples, const Neighbours& neighbours, const glm::dvec3& normal) {
    // Cosine of 45 degrees, the largest angle between `gap.across` and the direction of a
    // neighbour on the next scan line.
    constexpr double kMinAcrossCosine = 0.7071;
    // A neighbour is at most kMaxSlope * distance + kMaxPlaneNoise_m from the plane.
    constexpr double kMaxSlope = 0.1, kMaxPlaneNoise_m = 0.05;
    const glm::dvec3 point(samples[neighbours[0]].position);
    ScanLineGap gap{.across = find_across_line(samples, neighbours, normal)};
    for (std::size_t j = 1; j < neighbours.size() && gap.is_line_missing(); ++j) {
        const glm::dvec3 offset = glm::dvec3(samples[neighbours[j]].position) - point;
        const double length = glm::length(offset), across = glm::dot(offset, gap.across);
        const bool is_on_next_line = std::abs(across) > kMinAcrossCosine * length;
        const bool is_on_surface = std::abs(glm::dot(offset, normal)) < kMaxSlope * length + kMaxPlaneNoise_m;
        // The neighbours are sorted, so the first one on each side is the nearest.
        std::optional<double>& side_m = across > 0.0 ? gap.right_m : gap.left_m;
        if (!side_m && is_on_next_line && is_on_surface) side_m = length;
    }
    return gap;
}

/// Sets the SH coefficients of the intensity that a ray of direction d = (x, y, z) sees:
///   a (1 - q (1 - cos)) = 0.5 + kSh0 sh[0] + kSh1 (-y sh[1] + z sh[2] - x sh[3])
/// with cos = -n . d and the normal n towards the sensor. The albedo a follows from the
/// measured intensity.
/// @param sh  output: the coefficients 0 to 3
/// @param normal  on either side; zero if unknown, then q = 0
/// @param incidence  q, the strength of the dependence on the angle
void set_intensity(float* sh, const LidarSample& sample, const glm::dvec3& normal, double incidence) {
    constexpr double kGrazingCosine = 0.1;  // lower limit, because grazing rays give inaccurate albedos
    const double cosine = -glm::dot(normal, glm::normalize(glm::dvec3(sample.view)));
    const glm::dvec3 n = cosine < 0.0 ? -normal : normal;  // towards the sensor
    const double q = normal == glm::dvec3(0.0) ? 0.0 : incidence,
                 measured_cosine = std::max(std::abs(cosine), kGrazingCosine),
                 albedo = double(sample.intensity) / (1.0 - q * (1.0 - measured_cosine));
    // The part a q cos = -a q (n . d) is kSh1 (slope . d). The rest is a (1 - q).
    const glm::dvec3 slope = -albedo * q / kSh1 * n;
    sh[0] = (static_cast<float>(albedo * (1.0 - q)) - 0.5f) / kSh0;
    sh[1] = static_cast<float>(-slope.y);
    sh[2] = static_cast<float>(slope.z);
    sh[3] = static_cast<float>(-slope.x);
}

/// Sets the SH coefficients of degree 0 of the hit logit and the drop logit, so that a
/// ray probably returns. The value of a channel is 0.5 + kSh0 * coefficient.
void set_logits(float* sh, const InitOptions& options) {
    const double hit_logit = options.one_logit ? 0.0 : 0.5 * (1.0 + options.hit_margin),
                 drop_logit = hit_logit - options.hit_margin;
    sh[kShCoefficients] = (static_cast<float>(hit_logit) - 0.5f) / kSh0;
    sh[2 * kShCoefficients] = (static_cast<float>(drop_logit) - 0.5f) / kSh0;
}

/// Returns the indices of the `n` nearest samples and their squared distances, ascending.
Neighbours find_nearest(const Tree& tree, const LidarSample& sample, std::size_t n,
                        std::vector<float>& distance2) {
    Neighbours nearest(n);
    distance2.resize(n);
    nearest.resize(tree.knnSearch(&sample.position.x, n, nearest.data(), distance2.data()));
    distance2.resize(nearest.size());
    return nearest;
}

/// Plane in which a new surfel lies, and the distances to the scan lines beside it.
struct SurfelPlacement {
    NeighbourPlane plane;
    ScanLineGap gap;
};

/// Fits a plane to the nearest samples, and measures the gap between scan lines. If the
/// samples show only one line, or no line on one side, uses more samples than `nearest`,
/// the indices of the nearest ones, sorted by distance.
SurfelPlacement estimate_surface(const Tree& tree, const LidarSamples& samples, std::size_t sample,
                                 Neighbours nearest, const InitOptions& options) {
    constexpr int kMaxSearches = 2;  // maximum number of further searches for the plane
    const auto fit_plane = [&] {
        return fit_neighbours(samples, nearest, samples[sample].view, options.flatness);
    };
    const auto quadruple_nearest = [&] {
        std::vector<float> distance2;
        const std::size_t n = std::min(4 * nearest.size(), samples.size());
        nearest = find_nearest(tree, samples[sample], n, distance2);
    };
    SurfelPlacement placement{.plane = fit_plane(), .gap = {}};
    if (options.max_gap_m <= 0.0) return placement;  // gaps are not filled
    // Samples on one line do not determine a plane. More samples are on several lines.
    const bool was_line = placement.plane.is_line;
    for (int k = 0; was_line && !placement.plane.is_surface && k < kMaxSearches; ++k) {
        quadruple_nearest();
        const NeighbourPlane plane = fit_plane();
        if (!plane.is_surface) continue;
        placement.plane = plane;
        placement.plane.point = samples[sample].position;  // the mean of many samples is too coarse
    }
    if (!placement.plane.is_surface) return placement;
    placement.gap = measure_gap(samples, nearest, placement.plane.normal);
    const bool reaches_next_lines = was_line || !placement.gap.is_line_missing();
    if (reaches_next_lines) return placement;
    quadruple_nearest();
    placement.gap = measure_gap(samples, nearest, placement.plane.normal);
    return placement;
}

/// Sets the rotation and the two scales of a surfel. It is a disk whose size follows from
/// the spacing of the samples. If a wide gap between scan lines is next to it, the disk
/// becomes longer across the lines to fill this gap.
/// @param x first axis of a disk, perpendicular to the normal
void set_rotation_and_scales(Surfels& surfels, std::size_t surfel, const SurfelPlacement& placement,
                             glm::dvec3 x, double spacing_m, const InitOptions& options) {
    const double disk_m = std::min(spacing_m * options.scale_factor, options.max_scale_m);
    // Beyond the last scan line, no surface is known.
    const double gap_m =
        placement.gap.is_line_missing() ? 0.0 : std::max(*placement.gap.left_m, *placement.gap.right_m);
    const bool fills_gap = gap_m > kMinGapRatio * spacing_m && gap_m < options.max_gap_m;
    if (fills_gap) x = placement.gap.across;
    const glm::dvec3& normal = placement.plane.normal;
    const glm::dquat rotation = glm::quat_cast(glm::dmat3(x, glm::cross(normal, x), normal));
    surfels.rotation[surfel] = {float(rotation.w), float(rotation.x), float(rotation.y), float(rotation.z)};
    const double length_m = fills_gap ? gap_m * options.scale_factor : disk_m;
    const auto log_scale = [](double m) { return static_cast<float>(std::log(std::max(m, 1e-3))); };
    surfels.log_scale[surfel] = {log_scale(length_m), log_scale(disk_m)};
}

/// Returns the mean distance of a sample to the nearest other samples.
/// @param distance2 ascending squared distances; the first is that of the sample itself
double mean_spacing_m(const std::vector<float>& distance2, const InitOptions& options) {
    const std::size_t n_others = std::min<std::size_t>(distance2.size() - 1, kScaleNeighbours);
    double sum_m = 0.0;
    for (std::size_t j = 1; j <= n_others; ++j) sum_m += std::sqrt(distance2[j]);
    return n_others ? sum_m / double(n_others) : options.voxel_m;
}

/// Returns a random unit vector.
glm::dvec3 sample_direction(Random& random) {
    glm::dvec3 direction;
    // Draws z, y, x. Another order would change the surfels of a seed.
    for (int axis = 2; axis >= 0; --axis) direction[axis] = random.sample_normal();
    return direction / std::max(glm::length(direction), 1e-12);
}

/// Computes all parameters of a surfel from its sample and the nearby samples, which
/// determine its plane and size. Its normal is random if there are too few samples.
/// @param incidence  see set_intensity()
void set_surfel(Surfels& surfels, std::size_t surfel, const LidarSamples& samples, const Tree& tree,
                const InitOptions& options, double incidence) {
    const LidarSample& sample = samples[surfel];
    // The nearest samples include the sample itself, hence + 1.
    const std::size_t n_searched =
        std::min<std::size_t>(std::max(options.normal_neighbours, kScaleNeighbours) + 1, samples.size());
    std::vector<float> squared_m2;
    Neighbours nearest = find_nearest(tree, sample, n_searched, squared_m2);
    const double spacing_m = mean_spacing_m(squared_m2, options);
    nearest.resize(std::min(nearest.size(), std::size_t(options.normal_neighbours) + 1));

    Random random(hash_pair(options.seed, surfel));  // does not depend on the order of the threads
    SurfelPlacement placement;
    placement.plane.normal = sample_direction(random);
    if (options.normals && nearest.size() >= 3)
        placement = estimate_surface(tree, samples, surfel, std::move(nearest), options);
    const NeighbourPlane& plane = placement.plane;
    const glm::dvec3 x = perpendicular_at(plane.normal, random.sample_uniform(0.0, 2.0 * kPi));
    set_rotation_and_scales(surfels, surfel, placement, x, spacing_m, options);

    surfels.mean[surfel] = sample.position;
    // Moves the centre onto the plane, unless all samples count as surfaces (flatness 1).
    if (options.flatness < 1.0 && plane.is_surface)
        surfels.mean[surfel] -=
            glm::vec3(glm::dot(glm::dvec3(sample.position) - plane.point, plane.normal) * plane.normal);
    surfels.opacity_logit[surfel] = static_cast<float>(std::log(options.opacity / (1.0 - options.opacity)));
    float* sh = surfels.sh.data() + surfel * kShFloats;
    set_intensity(sh, sample, plane.is_surface ? plane.normal : glm::dvec3(0.0), incidence);
    set_logits(sh, options);
}

/// Returns a random number that depends only on a position, in steps of 0.1 mm.
std::uint64_t position_hash(const glm::vec3& p) {
    // z is shifted by three digits and added to y, because hash_pair() takes two numbers.
    return hash_pair(std::uint64_t(std::int64_t(p.x * 1e4f)),
                     std::uint64_t(std::int64_t(p.y * 1e4f + p.z * 1e7f)));
}

/// Returns a key of the voxel that contains a point of an actor: 10 bits per axis, with
/// the centre of the box at 512. 1024 voxels are longer than any actor.
std::uint64_t thinning_voxel_key(const glm::vec3& point_m) {
    constexpr double kThinningVoxel_m = 0.06;  // the jitter of labelled boxes blurs smaller details
    const glm::ivec3 cell = glm::ivec3(glm::floor(glm::dvec3(point_m) / kThinningVoxel_m)) + 512;
    return std::uint64_t(cell.x & 1023) << 20 | std::uint64_t(cell.y & 1023) << 10 |
           std::uint64_t(cell.z & 1023);
}

}  // namespace

Surfels make_surfels(const LidarSamples& samples, const InitOptions& options, double incidence,
                     const Progress& progress, SampleIndices* order) {
    const SampleKdTreeAdapter cloud{samples};
    const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(16));
    Surfels surfels;
    surfels.resize(samples.size());
    std::fill(surfels.sh.begin(), surfels.sh.end(), 0.0f);  // set_surfel() sets only degrees 0 and 1
    progress_blocks(samples.size(), progress, "estimating normals", [&](std::size_t index) {
        set_surfel(surfels, index, samples, tree, options, incidence);
    });
    const SampleIndices sorted = kd_tree_order(surfels.mean);
    if (order) *order = sorted;
    return surfels.reorder(sorted);
}

LidarSamples thin_samples(const LidarSamples& samples, std::size_t max_count, SampleIndices* selected) {
    std::unordered_set<std::uint64_t> occupied_voxels;
    SampleIndices first_in_voxel;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (occupied_voxels.insert(thinning_voxel_key(samples[i].position)).second)
            first_in_voxel.push_back(static_cast<std::uint32_t>(i));
    if (first_in_voxel.size() > max_count) {
        // Keeps a random subset, which does not depend on the order of the samples.
        std::ranges::sort(first_in_voxel, {},
                          [&](std::uint32_t i) { return position_hash(samples[i].position); });
        first_in_voxel.resize(max_count);
    }
    LidarSamples thin;
    for (const std::uint32_t i : first_in_voxel) thin.push_back(samples[i]);
    if (selected) *selected = std::move(first_in_voxel);
    return thin;
}

}  // namespace relidar
