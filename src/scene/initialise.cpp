// SPDX-License-Identifier: Apache-2.0
// Makes background surfels from the returns of the training frames. Averages the points
// of each voxel. Estimates normals and scales from nearest neighbours (docs/method.md
// section 2; paper section 3.2). Skips points in the boxes of moving objects.

#include "base/fail.hpp"
#include "base/geometry/nearest_place.hpp"
#include "base/parallel.hpp"
#include "base/parallel_sort.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"
#include "scene/point_surfels.hpp"
#include "scene/visibility.hpp"

namespace relidar {
namespace {

// Minimum ratio (frames with empty space) / (frames with a return) at a removed point. It
// is below 1, to also remove objects that stood still for part of the log.
constexpr double kGoneShare = 0.25;

struct VoxelSums {
    /// order of the first sample in the voxel: its frame in the high 32 bits, and its
    /// number in the frame in the low bits
    std::uint64_t first = 0;
    glm::dvec3 position{0.0}, view{0.0};
    double intensity = 0.0;
    int count = 0;
};

/// Cell of a voxel grid. Its edge length doubles with each level.
struct VoxelCell {
    int level, x, y, z;
    bool operator==(const VoxelCell&) const = default;
};
struct CellHash {
    std::size_t operator()(const VoxelCell& c) const {
        return hash_integer(hash_integer(std::uint64_t(std::uint32_t(c.x)) << 32 | std::uint32_t(c.y)) ^
                            (std::uint64_t(std::uint32_t(c.z)) << 8 | std::uint32_t(c.level)));
    }
};

/// Returns the points of one frame in the world frame. Skips points inside `boxes`,
/// because the objects in these boxes get separate models.
LidarSamples background_samples(const Log& log, const Frame& frame, const std::vector<BoxTrack>& boxes,
                                const InitOptions& options) {
    LidarSamples samples;
    for_each_return(log, frame, options.second_returns, [&](const WorldReturn& hit) {
        const auto is_in = [&](const BoxTrack& box) {
            return box.is_observed(hit.time_s) && box.contains_point(hit.point_m, hit.time_s, kMoverMargin_m);
        };
        if (std::ranges::any_of(boxes, is_in)) return;
        samples.push_back({glm::vec3(hit.point_m), hit.intensity, glm::vec3(hit.direction)});
    });
    return samples;
}

/// Returns the world position of each frame's LiDAR at the reference time of the frame.
std::vector<glm::vec3> frame_positions(const Log& log, const std::vector<int>& indices) {
    std::vector<glm::vec3> sensor_positions;
    for (const int position : indices) {
        const Frame& frame = log.frames[std::size_t(position)];
        sensor_positions.emplace_back(
            log.world_from_vehicle.mounted_pose_at(frame.time_s, log.lidar_of(frame).vehicle_from_sensor)
                .translation);
    }
    return sensor_positions;
}

/// Returns the voxel that contains a point. Its edge is `voxel_m` * 2^level, nearest to
/// `voxel_growth` * distance to the nearest sensor position, and at least `voxel_m`.
VoxelCell find_voxel_cell(const glm::vec3& point_m, const NearestPointFinder<float>& sensors,
                          const InitOptions& options) {
    int level = 0;
    if (options.voxel_growth > 0.0) {
        const double distance_m = std::sqrt(double(sensors.nearest_distance_sq(point_m)));
        const double wanted_edge_m = std::max(options.voxel_m, options.voxel_growth * distance_m);
        level = std::max(0, static_cast<int>(std::floor(std::log2(wanted_edge_m / options.voxel_m) + 0.5)));
    }
    const double edge_m = options.voxel_m * std::exp2(level);
    return {level, int(std::floor(point_m.x / edge_m)), int(std::floor(point_m.y / edge_m)),
            int(std::floor(point_m.z / edge_m))};
}

struct VoxelSample {
    LidarSample sample;
    VoxelCell cell;
    std::uint32_t index_in_frame;  ///< the first sample of a voxel defines its place in the result
};

/// Parts of the voxels, by hash. One thread per part adds samples without a lock.
constexpr std::size_t kHashParts = 32;
using VoxelSamplesByPart = std::array<std::vector<VoxelSample>, kHashParts>;

/// Finds the voxels of the background samples of a frame.
/// @param sensors  finds the nearest sensor position, because near voxels are smaller
VoxelSamplesByPart find_frame_voxels(const Log& log, const Frame& frame, const std::vector<BoxTrack>& boxes,
                                     const NearestPointFinder<float>& sensors, const InitOptions& options) {
    VoxelSamplesByPart by_part;
    std::uint32_t index_in_frame = 0;
    for (const LidarSample& sample : background_samples(log, frame, boxes, options)) {
        const VoxelCell cell = find_voxel_cell(sample.position, sensors, options);
        by_part[CellHash{}(cell) % kHashParts].push_back({sample, cell, index_in_frame++});
    }
    return by_part;
}

struct VoxelHashTable {
    std::unordered_map<VoxelCell, std::size_t, CellHash> index;
    std::vector<VoxelSums> voxels;

    void add_sample(const VoxelSample& added, std::size_t frame_index) {
        const auto [slot, is_new] = index.try_emplace(added.cell, voxels.size());
        if (is_new) voxels.push_back({.first = std::uint64_t(frame_index) << 32 | added.index_in_frame});
        VoxelSums& v = voxels[slot->second];
        v.position += glm::dvec3(added.sample.position);
        v.view += glm::dvec3(added.sample.view);
        v.intensity += added.sample.intensity;
        ++v.count;
    }
};

/// Returns the mean sample of each voxel, sorted by the first sample of the voxel. This
/// order does not depend on the threads.
LidarSamples mean_samples(std::vector<VoxelHashTable> tables) {
    std::vector<VoxelSums> voxels;
    for (VoxelHashTable& table : tables) {
        voxels.insert(voxels.end(), table.voxels.begin(), table.voxels.end());
        table = {};  // frees memory
    }
    parallel_sort(voxels,
                  [](const VoxelSums& left, const VoxelSums& right) { return left.first < right.first; });
    LidarSamples means;
    for (const VoxelSums& v : voxels)
        means.push_back({.position = glm::vec3(v.position / double(v.count)),
                         .intensity = static_cast<float>(v.intensity / v.count),
                         .view = glm::vec3(v.view / std::max(glm::length(v.view), 1e-12))});
    return means;
}

/// Averages the points of the background in each voxel. Reads only a few frames at a
/// time, so that memory does not grow with the number of frames.
LidarSamples average_voxels(const Log& log, const std::vector<int>& train_frames, const InitOptions& options,
                            const Progress& progress) {
    constexpr std::size_t kFramesPerBatch = 16;
    const std::vector<BoxTrack> separate = list_foreground(log, options);
    const NearestPointFinder<float> sensors(frame_positions(log, train_frames));
    std::vector<VoxelHashTable> tables(kHashParts);  // one for each part of the voxels
    for (std::size_t begin = 0; begin < train_frames.size(); begin += kFramesPerBatch) {
        if (progress)
            progress("collecting the points of the background", double(begin) / double(train_frames.size()));
        std::vector<VoxelSamplesByPart> frames(std::min(kFramesPerBatch, train_frames.size() - begin));
        parallel_for(static_cast<int>(frames.size()), [&](int index) {
            const Frame& frame = log.frames[std::size_t(train_frames[begin + std::size_t(index)])];
            frames[std::size_t(index)] = find_frame_voxels(log, frame, separate, sensors, options);
        });
        // One thread per part adds the samples to its voxels, in the order of the frames.
        // A sum then does not depend on the threads.
        parallel_for(kHashParts, [&](int part) {
            for (std::size_t i = 0; i < frames.size(); ++i)
                for (const VoxelSample& sample : frames[i][std::size_t(part)])
                    tables[std::size_t(part)].add_sample(sample, begin + i);
        });
    }
    if (progress) progress("collecting the points of the background", 1.0);
    return mean_samples(std::move(tables));
}

/// Removes samples where other frames observe empty space: they are on moving objects.
LidarSamples remove_movers(const LidarSamples& samples, const Log& log, const std::vector<int>& frames,
                           const Progress& progress) {
    VisibilityChecker visibility(log, frames);
    std::vector<glm::vec3> points;
    for (const LidarSample& sample : samples) points.push_back(sample.position);
    visibility.make_images(points);
    std::vector<char> is_static(samples.size());
    progress_blocks(samples.size(), progress, "removing moving points", [&](std::size_t index) {
        is_static[index] = !visibility.count_votes(samples[index].position).is_empty_space(kGoneShare);
    });
    LidarSamples static_samples;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (is_static[i]) static_samples.push_back(samples[i]);
    return static_samples;
}

}  // namespace

Surfels init_background(const Log& log, const std::vector<int>& frames, const InitOptions& options,
                        const Progress& progress) {
    LidarSamples samples = average_voxels(log, frames, options, progress);
    if (options.unlabelled_movers != UnlabelledMoverPolicy::background)
        samples = remove_movers(samples, log, frames, progress);
    if (samples.empty())
        fail(
            "cannot initialise the background of {}: its {} training frames have no LiDAR return outside the "
            "boxes of moving objects, expected at least one",
            log.name, frames.size());
    return make_surfels(samples, options, log.intensity_response.incidence, progress);
}

}  // namespace relidar
