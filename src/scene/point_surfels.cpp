// SPDX-License-Identifier: Apache-2.0
// Computes the normal, the scales and the initial parameters of each surfel from nearby
// points (docs/method.md section 2; paper section 3.2).
#include "scene/point_surfels.hpp"

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

/// Fits a plane to neighbouring points. The normal is the eigenvector of the smallest
/// eigenvalue. If all points lie on one scan line, the normal is the one that faces the
/// sensor most. If the points form no surface, the normal points to the sensor, because
/// rays of the next scan would miss a surfel that is edge-on.
NeighbourPlane fit_neighbours(const LidarSamples& samples, const Neighbours& neighbours,
                              const glm::dvec3& direction, double flatness) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const std::size_t j : neighbours)
        mean += Eigen::Vector3d(samples[j].position.x, samples[j].position.y, samples[j].position.z);
    mean /= double(neighbours.size());
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const std::size_t j : neighbours) {
        const Eigen::Vector3d d =
            Eigen::Vector3d(samples[j].position.x, samples[j].position.y, samples[j].position.z) - mean;
        covariance += d * d.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Vector3d& values = solver.eigenvalues();
    const Eigen::Matrix3d& axes = solver.eigenvectors();
    glm::dvec3 normal(axes(0, 0), axes(1, 0), axes(2, 0));
    const bool is_line = values[1] < 0.02 * values[2];
    if (is_line || !(values[2] > 0.0)) {
        const glm::dvec3 line(axes(0, 2), axes(1, 2), axes(2, 2));
        normal = -direction + (values[2] > 0.0 ? glm::dot(direction, line) * line : glm::dvec3(0.0));
    }
    const bool is_surface = !is_line && values[0] < flatness * values[1];
    if (!is_line && !is_surface) normal = -direction;
    const double length = glm::length(normal);
    return {
        {mean.x(), mean.y(), mean.z()}, length > 1e-9 ? normal / length : -direction, is_line, is_surface};
}

/// Returns a unit vector perpendicular to a normal, rotated about the normal by an angle.
glm::dvec3 perpendicular_at(const glm::dvec3& normal, double angle_rad) {
    const glm::dvec3 helper = std::abs(normal.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0);
    const glm::dvec3 x = glm::normalize(glm::cross(helper, normal));
    return std::cos(angle_rad) * x + std::sin(angle_rad) * glm::cross(normal, x);
}

/// Distances to the neighbouring scan lines on a surface, along `across`, which is
/// perpendicular to the scan lines. 0 if no point exists.
struct ScanLineGap {
    glm::dvec3 across{0.0};
    double left_m = 0.0, right_m = 0.0;

    bool is_line_missing() const { return left_m == 0.0 || right_m == 0.0; }
};

/// Measures the distance from a point to the next scan line on each side.
/// @param neighbours indices of points on the surface, sorted by distance; the first is
/// the point itself
ScanLineGap measure_gap(const LidarSamples& samples, const Neighbours& neighbours, const glm::dvec3& normal) {
    // number of nearest neighbours that lie on the same scan line as the point
    constexpr std::size_t kOnLine = 4;
    // Cosine of 45 degrees, the largest angle between `gap.across` and the direction of a
    // neighbour on the next scan line.
    constexpr double kMinAcrossCosine = 0.7071;
    // Maximum distance of a neighbour from the surface plane: kMaxSlope * distance +
    // kMaxPlaneNoise_m.
    constexpr double kMaxSlope = 0.1, kMaxPlaneNoise_m = 0.05;
    const glm::dvec3 point(samples[neighbours[0]].position), x = perpendicular_at(normal, 0.0),
                                                             y = glm::cross(normal, x);
    // Averages the directions to the nearest points, which lie on the same scan line.
    // Doubles each angle, because opposite directions mean the same line.
    double even = 0.0, odd = 0.0;
    for (std::size_t j = 1; j < std::min(neighbours.size(), kOnLine + 1); ++j) {
        const glm::dvec3 d = glm::dvec3(samples[neighbours[j]].position) - point;
        const double u = glm::dot(d, x), v = glm::dot(d, y), length2 = std::max(u * u + v * v, 1e-12);
        even += (u * u - v * v) / length2;
        odd += 2.0 * u * v / length2;
    }
    ScanLineGap gap{perpendicular_at(normal, 0.5 * std::atan2(odd, even) + 0.5 * kPi)};
    for (std::size_t j = 1; j < neighbours.size() && gap.is_line_missing(); ++j) {
        const glm::dvec3 d = glm::dvec3(samples[neighbours[j]].position) - point;
        const double length = glm::length(d), across = glm::dot(d, gap.across);
        double& on_side = across > 0.0 ? gap.right_m : gap.left_m;
        if (on_side == 0.0 && std::abs(across) > kMinAcrossCosine * length &&
            std::abs(glm::dot(d, normal)) < kMaxSlope * length + kMaxPlaneNoise_m)
            on_side = length;
    }
    return gap;
}

/// Sets the SH coefficients of degrees 0 and 1. They encode the intensity a (1 - q (1 -
/// cos)) with albedo a and cos = -n . d, where d is the direction of a ray towards the
/// surface. Grazing angles have a lower limit, because their albedo is inaccurate.
/// @param normal zero if unknown; then the intensity is the same from all directions
void set_harmonics(float* sh, const LidarSample& sample, const glm::dvec3& normal, double incidence) {
    constexpr double kGrazingCosine = 0.1;
    const double facing = -glm::dot(normal, glm::normalize(glm::dvec3(sample.view)));
    const glm::dvec3 n = facing < 0.0 ? -normal : normal;
    const double q = normal == glm::dvec3(0.0) ? 0.0 : incidence,
                 albedo = double(sample.intensity) /
                          (1.0 - q * (1.0 - std::max(std::abs(facing), kGrazingCosine)));
    const glm::dvec3 slope = -albedo * q / kSh1 * n;  // SH coefficients of degree 1 for the axes x, y, z
    sh[0] = (static_cast<float>(albedo * (1.0 - q)) - 0.5f) / kSh0;
    sh[1] = static_cast<float>(-slope.y);
    sh[2] = static_cast<float>(slope.z);
    sh[3] = static_cast<float>(-slope.x);
}

/// Returns the indices of the `n` nearest samples, sorted by distance.
Neighbours find_nearest(const Tree& tree, const LidarSample& sample, std::size_t n, std::vector<float>& d2) {
    Neighbours samples(n);
    d2.resize(n);
    samples.resize(tree.knnSearch(&sample.position.x, n, samples.data(), d2.data()));
    return samples;
}

/// Plane in which a new surfel lies, and the distances to the scan lines beside it.
struct SurfelPlacement {
    NeighbourPlane plane;
    ScanLineGap gap;
};

/// Fits a plane to the nearest samples, and measures the gap between scan lines. Uses
/// more samples if all lie on one scan line, because the plane could rotate about this
/// line, or if there is no sample on the left or right scan line.
SurfelPlacement estimate_surface(const Tree& tree, const LidarSamples& samples, std::size_t sample,
                                 Neighbours nearest, const InitOptions& options) {
    constexpr int kMaxWidenings = 2;  // maximum number of repeated searches with more neighbours
    SurfelPlacement placement{fit_neighbours(samples, nearest, samples[sample].view, options.flatness), {}};
    if (options.max_gap_m <= 0.0) return placement;
    const auto widen = [&] {
        std::vector<float> distance2;
        nearest =
            find_nearest(tree, samples[sample], std::min(4 * nearest.size(), samples.size()), distance2);
    };
    const bool is_line = placement.plane.is_line;
    for (int k = 0; is_line && !placement.plane.is_surface && k < kMaxWidenings; ++k) {
        widen();
        const NeighbourPlane wider = fit_neighbours(samples, nearest, samples[sample].view, options.flatness);
        // The position of the wider plane is too coarse. The new plane passes through the
        // sample.
        if (wider.is_surface) placement.plane = {samples[sample].position, wider.normal, true, true};
    }
    if (!placement.plane.is_surface) return placement;
    placement.gap = measure_gap(samples, nearest, placement.plane.normal);
    if (is_line || !placement.gap.is_line_missing()) return placement;
    widen();
    placement.gap = measure_gap(samples, nearest, placement.plane.normal);
    return placement;
}

/// Computes all parameters of a surfel from its sample and the nearby samples.
void set_surfel(Surfels& surfels, std::size_t surfel, const LidarSamples& samples, const Tree& tree,
                const InitOptions& options, double incidence) {
    const std::size_t k =
        std::min<std::size_t>(std::max(options.normal_neighbours, kScaleNeighbours) + 1, samples.size());
    std::vector<float> distance2;
    Neighbours nearest = find_nearest(tree, samples[surfel], k, distance2);
    // The mean distance to the three nearest other samples determines the scale.
    double distance_sum_m = 0.0;
    std::size_t n_others = 0;
    for (std::size_t j = 1; j < nearest.size() && n_others < kScaleNeighbours; ++j, ++n_others)
        distance_sum_m += std::sqrt(distance2[j]);
    const double spacing = n_others ? distance_sum_m / double(n_others) : options.voxel_m;
    Random random(hash_pair(options.seed, surfel));
    nearest.resize(std::min(nearest.size(), std::size_t(options.normal_neighbours) + 1));
    // Draws in the order z, y, x. Another order would change the surfels of a seed.
    glm::dvec3 random_direction;
    for (int axis = 2; axis >= 0; --axis) random_direction[axis] = random.sample_normal();
    SurfelPlacement placement{{{}, random_direction / std::max(glm::length(random_direction), 1e-12)}, {}};
    if (options.normals && nearest.size() >= 3)
        placement = estimate_surface(tree, samples, surfel, std::move(nearest), options);
    const NeighbourPlane& plane = placement.plane;
    surfels.mean[surfel] = samples[surfel].position;
    if (options.flatness < 1.0 && plane.is_surface)
        surfels.mean[surfel] -= glm::vec3(
            glm::dot(glm::dvec3(samples[surfel].position) - plane.point, plane.normal) * plane.normal);
    glm::dvec3 x = perpendicular_at(plane.normal, random.sample_uniform(0.0, 2.0 * kPi));
    const double width = std::max(placement.gap.left_m, placement.gap.right_m),
                 round = std::min(spacing * options.scale_factor, options.max_scale_m);
    // A wide gap between scan lines is filled: the surfel becomes longer across the
    // lines.
    const bool reaches =
        !placement.gap.is_line_missing() && width > kMinGapRatio * spacing && width < options.max_gap_m;
    if (reaches) x = placement.gap.across;
    const glm::dquat q = glm::quat_cast(glm::dmat3(x, glm::cross(plane.normal, x), plane.normal));
    surfels.rotation[surfel] = {float(q.w), float(q.x), float(q.y), float(q.z)};
    const auto log_scale = [](double m) { return static_cast<float>(std::log(std::max(m, 1e-3))); };
    surfels.log_scale[surfel] = {log_scale(reaches ? width * options.scale_factor : round), log_scale(round)};
    surfels.opacity_logit[surfel] = static_cast<float>(std::log(options.opacity / (1.0 - options.opacity)));
    float* sh = surfels.sh.data() + surfel * kShFloats;
    set_harmonics(sh, samples[surfel], plane.is_surface ? plane.normal : glm::dvec3(0.0), incidence);
    const double hit_logit = options.one_logit ? 0.0 : 0.5 * (1.0 + options.hit_margin),
                 drop_logit = hit_logit - options.hit_margin;
    sh[kShCoefficients] = (static_cast<float>(hit_logit) - 0.5f) / kSh0;
    sh[2 * kShCoefficients] = (static_cast<float>(drop_logit) - 0.5f) / kSh0;
}

}  // namespace

Surfels make_surfels(const LidarSamples& samples, const InitOptions& options, double incidence,
                     const Progress& progress, SampleIndices* order) {
    const SampleKdTreeAdapter cloud{samples};
    const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(16));
    Surfels surfels;
    surfels.resize(samples.size());
    std::fill(surfels.sh.begin(), surfels.sh.end(), 0.0f);
    progress_blocks(samples.size(), progress, "estimating normals", [&](std::size_t index) {
        set_surfel(surfels, index, samples, tree, options, incidence);
    });
    const SampleIndices sorted = kd_tree_order(surfels.mean);
    if (order) *order = sorted;
    return surfels.reorder(sorted);
}

LidarSamples thin_samples(const LidarSamples& samples, std::size_t most, SampleIndices* kept) {
    // Edge length of a voxel. The jitter of labelled boxes blurs smaller details.
    constexpr double kThinningVoxel_m = 0.06;
    std::unordered_set<std::uint64_t> occupied_voxels;
    SampleIndices first;
    for (std::size_t i = 0; i < samples.size(); ++i) {
        // Key of the voxel with 10 bits per axis; the box centre is at 512.
        const glm::ivec3 cell =
            glm::ivec3(glm::floor(glm::dvec3(samples[i].position) / kThinningVoxel_m)) + 512;
        const std::uint64_t key = std::uint64_t(cell.x & 1023) << 20 | std::uint64_t(cell.y & 1023) << 10 |
                                  std::uint64_t(cell.z & 1023);
        if (occupied_voxels.insert(key).second) first.push_back(static_cast<std::uint32_t>(i));
    }
    if (first.size() > most) {
        // A random subset that depends only on positions, not on the sample order.
        const auto order = [&](std::uint32_t index) {
            const glm::vec3& p = samples[index].position;
            return hash_pair(std::uint64_t(std::int64_t(p.x * 1e4f)),
                             std::uint64_t(std::int64_t(p.y * 1e4f + p.z * 1e7f)));
        };
        std::sort(first.begin(), first.end(),
                  [&](std::uint32_t left, std::uint32_t right) { return order(left) < order(right); });
        first.resize(most);
    }
    LidarSamples thin;
    for (const std::uint32_t i : first) thin.push_back(samples[i]);
    if (kept) *kept = std::move(first);
    return thin;
}

}  // namespace relidar
