// SPDX-License-Identifier: Apache-2.0
// Background surfels from the training frames: points averaged per voxel, normals and scales from nearest neighbours (docs/method.md
// section 2; paper section 3.2). Points of moving boxes are left out, and no held-out frame is looked at.
#include <relidar/scene.hpp>

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>
#include <nanoflann.hpp>

#include <relidar/error.hpp>

#include "core/parallel.hpp"
#include "core/random.hpp"
#include "scene/visibility.hpp"

namespace relidar {

namespace {

constexpr float kSh0 = 0.28209479177387814f;   ///< constant of SH degree 0
constexpr int kScaleNeighbours = 3;

/// A point of the log: where, how bright, and from where it was seen.
struct Sample {
    glm::vec3 position;
    float intensity;
    glm::vec3 view;   ///< unit, sensor to point
};

/// Running means of the samples of one voxel.
struct Voxel {
    glm::dvec3 position{0.0};
    glm::dvec3 view{0.0};
    double intensity = 0.0;
    int count = 0;
};

/// Integer cell of a voxel grid whose edge doubles with every level.
struct Cell {
    int level, x, y, z;
    bool operator==(const Cell&) const = default;
};
struct CellHash {
    std::size_t operator()(const Cell& c) const {
        return hash64(hash64(std::uint64_t(std::uint32_t(c.x)) << 32 | std::uint32_t(c.y)) ^ (std::uint64_t(std::uint32_t(c.z)) << 8 | std::uint32_t(c.level)));
    }
};

/// Points of one frame in the world, each from where the sensor was when it fired.
std::vector<Sample> frame_samples(const Sequence& sequence, const Frame& frame, const InitialiseOptions& options) {
    std::vector<Sample> samples;
    const Scan& scan = frame.scan;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        const WorldRay w = world_ray(sequence.world_from_sensor, frame.time_s, scan.rays, ray, sequence.rolling_shutter);
        const glm::dvec3 p = w.origin_m + double(scan.range_m[ray]) * w.direction;
        const double t_s = frame.time_s + (sequence.rolling_shutter ? scan.rays.time_offset_s[ray] : 0.0f);
        if (in_moving_box(sequence.boxes, p, t_s, options.actor_min_step_m, options.actor_margin_m)) continue;
        samples.push_back({glm::vec3(p), scan.intensity[ray], glm::vec3(w.direction)});
    }
    return samples;
}

/// Voxel edge at a point: voxel_m, doubled where the point is far from every sensor position (voxel_growth > 0).
Cell cell_of(const glm::vec3& p, const std::vector<glm::vec3>& sensors, const InitialiseOptions& options) {
    int level = 0;
    if (options.voxel_growth > 0.0) {
        float nearest2 = 1e30f;
        for (const glm::vec3& s : sensors) nearest2 = std::min(nearest2, glm::dot(p - s, p - s));
        const double edge = std::max(options.voxel_m, options.voxel_growth * std::sqrt(double(nearest2)));
        level = std::max(0, static_cast<int>(std::floor(std::log2(edge / options.voxel_m) + 0.5)));
    }
    const double edge = options.voxel_m * std::exp2(level);
    return {level, int(std::floor(p.x / edge)), int(std::floor(p.y / edge)), int(std::floor(p.z / edge))};
}

/// Voxel means in a reproducible order: that of first appearance.
std::vector<Sample> voxel_means(const Sequence& sequence, const std::vector<int>& train, const InitialiseOptions& options) {
    std::vector<std::vector<Sample>> samples(train.size());
    run_parallel(static_cast<int>(train.size()), [&](int i) {
        samples[std::size_t(i)] = frame_samples(sequence, sequence.frames[std::size_t(train[std::size_t(i)])], options);
    });
    std::vector<glm::vec3> sensors;
    for (const int position : train) sensors.push_back(glm::vec3(sequence.world_from_sensor.at(sequence.frames[std::size_t(position)].time_s).translation));
    std::unordered_map<Cell, std::size_t, CellHash> index;
    std::vector<Voxel> voxels;
    for (const std::vector<Sample>& frame : samples)
        for (const Sample& s : frame) {
            const auto [slot, is_new] = index.try_emplace(cell_of(s.position, sensors, options), voxels.size());
            if (is_new) voxels.emplace_back();
            Voxel& v = voxels[slot->second];
            v.position += glm::dvec3(s.position);
            v.view += glm::dvec3(s.view);
            v.intensity += s.intensity;
            ++v.count;
        }
    std::vector<Sample> means;
    for (const Voxel& v : voxels)
        means.push_back({glm::vec3(v.position / double(v.count)), static_cast<float>(v.intensity / v.count), glm::vec3(v.view / std::max(glm::length(v.view), 1e-12))});
    return means;
}

/// task(i) for every i < n, on all cores in blocks.
template <class Task>
void for_each_block(std::size_t n, const Task& task) {
    constexpr std::size_t kBlock = 4096;
    run_parallel(static_cast<int>((n + kBlock - 1) / kBlock), [&](int block) {
        const std::size_t end = std::min(n, (std::size_t(block) + 1) * kBlock);
        for (std::size_t i = std::size_t(block) * kBlock; i < end; ++i) task(i);
    });
}

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
    bool is_surface = false;   ///< the points spread along two axes and hardly along the third
};

/// Normal: eigenvector of the smallest eigenvalue. Points along one scan line leave it free to turn about the line; then it faces
/// the sensor as far as the line allows.
Plane fit_plane(const std::vector<Sample>& samples, const std::vector<std::size_t>& neighbours, const glm::dvec3& view) {
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
    const double length = glm::length(normal);
    return {{mean.x(), mean.y(), mean.z()}, length > 1e-9 ? normal / length : -view, !is_line && values[0] < 0.04 * values[1]};
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

/// Fills surfel i from its sample and neighbours.
void fill_surfel(Surfels& surfels, std::size_t i, const std::vector<Sample>& samples, const Tree& tree, const InitialiseOptions& options) {
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
    if (options.normals && found.size() >= 3) plane = fit_plane(samples, found, samples[i].view);
    surfels.mean[i] = samples[i].position;
    if (options.smooth && plane.is_surface) surfels.mean[i] -= glm::vec3(glm::dot(glm::dvec3(samples[i].position) - plane.point, plane.normal) * plane.normal);
    surfels.rotation[i] = rotation_to(plane.normal, random.uniform(0.0, 2.0 * kPi));
    surfels.log_scale[i] = glm::vec2(static_cast<float>(std::log(std::clamp(scale * options.scale_factor, 1e-3, options.max_scale_m))));
    surfels.opacity_logit[i] = static_cast<float>(std::log(options.opacity / (1.0 - options.opacity)));
    float* sh = surfels.sh.data() + i * kShFloats;
    sh[0] = (samples[i].intensity - 0.5f) / kSh0;
    sh[kShCoefficients] = (1.0f - 0.5f) / kSh0;        // hit logit 1
    sh[2 * kShCoefficients] = (0.0f - 0.5f) / kSh0;    // drop logit 0
}

/// Leaves out samples that at least two frames see through, and a quarter as many as see them.
std::vector<Sample> without_movers(const std::vector<Sample>& samples, const Sequence& sequence, const std::vector<int>& train) {
    const Visibility visibility(sequence, train);
    std::vector<char> keep(samples.size());
    for_each_block(samples.size(), [&](std::size_t i) {
        const Visibility::Votes v = visibility.votes(samples[i].position);
        keep[i] = v.seen_through < 2 || 4 * v.seen_through < v.seen;
    });
    std::vector<Sample> kept;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (keep[i]) kept.push_back(samples[i]);
    return kept;
}

}  // namespace

Surfels initialise_background(const Sequence& sequence, const std::vector<int>& train_positions, const InitialiseOptions& options) {
    std::vector<Sample> samples = voxel_means(sequence, train_positions, options);
    if (options.remove_unlabelled_movers) samples = without_movers(samples, sequence, train_positions);
    if (samples.empty())
        throw DataError(fmt::format("initialising the background of {}: found no return outside moving boxes in {} training frames, expected at least one", sequence.name, train_positions.size()));
    const Cloud cloud{samples};
    const Tree tree(3, cloud, nanoflann::KDTreeSingleIndexAdaptorParams(16));
    Surfels surfels;
    surfels.resize(samples.size());
    std::fill(surfels.sh.begin(), surfels.sh.end(), 0.0f);
    for_each_block(samples.size(), [&](std::size_t i) { fill_surfel(surfels, i, samples, tree, options); });
    return surfels.permuted(kd_order(surfels.mean));
}

}  // namespace relidar
