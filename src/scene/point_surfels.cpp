// SPDX-License-Identifier: Apache-2.0
// Normals, scales and start values of surfels from the points around each (docs/method.md section 2; paper section 3.2).
#include "scene/point_surfels.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <nanoflann.hpp>

#include "core/random.hpp"
#include "core/progress_blocks.hpp"

namespace relidar {

namespace {

constexpr float kSh0 = 0.28209479177387814f;   ///< constant of SH degree 0
constexpr double kSh1 = 0.4886025119029199;    ///< of degree 1: -y, z, -x
constexpr int kScaleNeighbours = 3;

/// nanoflann's view of the samples.
struct Cloud {
    const std::vector<Sample>& samples;
    std::size_t kdtree_get_point_count() const { return samples.size(); }
    float kdtree_get_pt(std::size_t i, std::size_t axis) const { return samples[i].position[static_cast<int>(axis)]; }
    template <class Box>
    bool kdtree_get_bbox(Box&) const { return false; }
};
using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Cloud>, Cloud, 3, std::size_t>;

/// The plane of a neighbourhood.
struct Plane {
    glm::dvec3 point{0.0};
    glm::dvec3 normal{0.0};
    bool is_surface = false;   ///< the points spread along two axes, and less along the third than options.flatness says
};

/// Normal: eigenvector of the smallest eigenvalue. Points along one scan line leave it free to turn about the line; then it faces
/// the sensor as far as the line allows. Points that are no surface have no normal either. Their discs face the sensor, too: others are
/// seen edge on, so that rays of the next scan pass by and return from behind.
Plane fit_plane(const std::vector<Sample>& samples, const std::vector<std::size_t>& neighbours, const glm::dvec3& view, double flatness) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const std::size_t j : neighbours) mean += Eigen::Vector3d(samples[j].position.x, samples[j].position.y, samples[j].position.z);
    mean /= double(neighbours.size());
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const std::size_t j : neighbours) {
        const Eigen::Vector3d d = Eigen::Vector3d(samples[j].position.x, samples[j].position.y, samples[j].position.z) - mean;
        covariance += d * d.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    const Eigen::Vector3d values = solver.eigenvalues();
    const Eigen::Matrix3d axes = solver.eigenvectors();
    glm::dvec3 normal(axes(0, 0), axes(1, 0), axes(2, 0));
    const bool is_line = values[1] < 0.02 * values[2];
    if (is_line || !(values[2] > 0.0)) {
        const glm::dvec3 line(axes(0, 2), axes(1, 2), axes(2, 2));
        normal = -view + (values[2] > 0.0 ? glm::dot(view, line) * line : glm::dvec3(0.0));
    }
    const bool is_surface = !is_line && values[0] < flatness * values[1];
    if (!is_line && !is_surface) normal = -view;
    const double length = glm::length(normal);
    return {{mean.x(), mean.y(), mean.z()}, length > 1e-9 ? normal / length : -view, is_surface};
}

/// Rotation whose third column is the normal, turned about it by an angle.
glm::vec4 rotation_to(const glm::dvec3& normal, double angle) {
    const glm::dvec3 helper = std::abs(normal.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0);
    const glm::dvec3 x0 = glm::normalize(glm::cross(helper, normal)), y0 = glm::cross(normal, x0);
    const glm::dvec3 x = std::cos(angle) * x0 + std::sin(angle) * y0;
    const glm::dquat q = glm::quat_cast(glm::dmat3(x, glm::cross(normal, x), normal));
    return {float(q.w), float(q.x), float(q.y), float(q.z)};
}

glm::dvec3 random_direction(Random& random) {
    const glm::dvec3 d(random.normal(), random.normal(), random.normal());
    return d / std::max(glm::length(d), 1e-12);
}

/// Intensity a (1 - q (1 - cos)) with cos = -n . d for rays of direction d towards the surface: harmonics of degrees 0 and 1. What was seen
/// at a grazing angle says little of a. @param normal zero where there is none: as bright from every side
void fill_intensity(float* sh, const Sample& sample, const glm::dvec3& normal, double incidence) {
    constexpr double kGrazing = 0.1;
    const double facing = -glm::dot(normal, glm::normalize(glm::dvec3(sample.view)));
    const glm::dvec3 n = facing < 0.0 ? -normal : normal;
    const double q = normal == glm::dvec3(0.0) ? 0.0 : incidence,
                 albedo = double(sample.intensity) / (1.0 - q * (1.0 - std::max(std::abs(facing), kGrazing)));
    const glm::dvec3 slope = -albedo * q / kSh1 * n;   // of a direction's y, z, x
    sh[0] = (static_cast<float>(albedo * (1.0 - q)) - 0.5f) / kSh0;
    sh[1] = static_cast<float>(-slope.y);
    sh[2] = static_cast<float>(slope.z);
    sh[3] = static_cast<float>(-slope.x);
}

/// Fills surfel i from its sample and neighbours.
void fill_surfel(Surfels& surfels, std::size_t i, const std::vector<Sample>& samples, const Tree& tree, const InitialiseOptions& options,
                 double incidence) {
    const std::size_t k = std::min<std::size_t>(std::max(options.normal_neighbours, kScaleNeighbours) + 1, samples.size());
    std::vector<std::size_t> found(k);
    std::vector<float> distance2(k);
    const std::size_t n_found = tree.knnSearch(&samples[i].position.x, k, found.data(), distance2.data());   // the point itself comes first
    double distance = 0.0;
    std::size_t n_near = 0;
    for (std::size_t j = 1; j < n_found && n_near < kScaleNeighbours; ++j, ++n_near) distance += std::sqrt(distance2[j]);
    const double scale = n_near ? distance / double(n_near) : options.voxel_m;
    Random random(hash64(options.seed, i));
    found.resize(std::min<std::size_t>(n_found, std::size_t(options.normal_neighbours) + 1));
    Plane plane{{}, random_direction(random)};
    if (options.normals && found.size() >= 3) plane = fit_plane(samples, found, samples[i].view, options.flatness);
    surfels.mean[i] = samples[i].position;
    if (options.smooth && plane.is_surface)
        surfels.mean[i] -= glm::vec3(glm::dot(glm::dvec3(samples[i].position) - plane.point, plane.normal) * plane.normal);
    surfels.rotation[i] = rotation_to(plane.normal, random.uniform(0.0, 2.0 * kPi));
    surfels.log_scale[i] = glm::vec2(static_cast<float>(std::log(std::clamp(scale * options.scale_factor, 1e-3, options.max_scale_m))));
    surfels.opacity_logit[i] = static_cast<float>(std::log(options.opacity / (1.0 - options.opacity)));
    float* sh = surfels.sh.data() + i * kShFloats;
    fill_intensity(sh, samples[i], plane.is_surface ? plane.normal : glm::dvec3(0.0), incidence);
    sh[kShCoefficients] = (static_cast<float>(options.hit_logit) - 0.5f) / kSh0;
    sh[2 * kShCoefficients] = (static_cast<float>(options.drop_logit) - 0.5f) / kSh0;
}

}  // namespace

Surfels surfels_from_points(const std::vector<Sample>& samples, const InitialiseOptions& options, double incidence,
                            const Progress& progress) {
    const Cloud cloud{samples};
    const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(16));
    Surfels surfels;
    surfels.resize(samples.size());
    std::fill(surfels.sh.begin(), surfels.sh.end(), 0.0f);
    for_each_block_told(samples.size(), progress, "normals",
                        [&](std::size_t i) { fill_surfel(surfels, i, samples, tree, options, incidence); });
    return surfels.permuted(kd_order(surfels.mean));
}

}  // namespace relidar
