// SPDX-License-Identifier: Apache-2.0
// Makes background surfels from the returns of the training frames. Averages the points
// of each voxel. Estimates normals and scales from nearest neighbours (docs/method.md
// section 2; paper section 3.2). Skips points in the boxes of moving objects. Never reads
// the held-out frames.
#include <relidar/scene/scene.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <unordered_map>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/nearest_place.hpp"
#include "base/parallel.hpp"
#include "base/parallel_sort.hpp"
#include "base/progress_blocks.hpp"
#include "base/random.hpp"
#include "scene/point_surfels.hpp"
#include "scene/visibility.hpp"

namespace relidar {

namespace {

// A point is removed if the frames that look through it are at least this share of the
// frames that hit it. A share of 1 would keep objects that stood still for part of the
// log.
constexpr double kGoneShare = 0.25;

/// Running sums of the samples in one voxel.
struct Voxel {
    std::uint64_t first = 0;  ///< index of the first sample in the voxel, counted over all frames
    glm::dvec3 position{0.0};
    glm::dvec3 view{0.0};
    double intensity = 0.0;
    int count = 0;
};

/// Cell of a voxel grid with integer coordinates. The edge length of a cell doubles with
/// each level.
struct Cell {
    int level, x, y, z;
    bool operator==(const Cell&) const = default;
};
struct CellHash {
    std::size_t operator()(const Cell& c) const {
        return combine_hashes(combine_hashes(std::uint64_t(std::uint32_t(c.x)) << 32 | std::uint32_t(c.y)) ^
                              (std::uint64_t(std::uint32_t(c.z)) << 8 | std::uint32_t(c.level)));
    }
};

/// Returns the points of one frame in the world frame, with the direction of each ray.
/// Skips points inside the boxes `separate`, because these objects have models of their
/// own.
std::vector<Sample> collect_frame_samples(const Sequence& sequence, const Frame& frame,
                                          const std::vector<BoxTrack>& separate,
                                          const InitialiseOptions& options) {
    std::vector<Sample> samples;
    for_each_return(sequence, frame, options.second_returns, [&](const WorldReturn& world_return) {
        const auto is_in = [&](const BoxTrack& box) {
            return box.is_present(world_return.time_s) &&
                   box.holds(world_return.point_m, world_return.time_s, kMoverMargin_m);
        };
        if (std::ranges::any_of(separate, is_in)) return;
        samples.push_back(
            {glm::vec3(world_return.point_m), world_return.intensity, glm::vec3(world_return.direction)});
    });
    return samples;
}

/// Returns the position of the sensor in each of the given frames.
/// @return [positions] world
std::vector<glm::vec3> list_sensor_positions(const Sequence& sequence, const std::vector<int>& positions) {
    std::vector<glm::vec3> places;
    for (const int position : positions) {
        const Frame& frame = sequence.frames[std::size_t(position)];
        places.emplace_back(
            sequence.world_from_vehicle.at(frame.time_s, sequence.get_lidar(frame).vehicle_from_sensor)
                .translation);
    }
    return places;
}

/// Returns the voxel that contains a point. The edge of a voxel is `voxel_m`. If
/// `voxel_growth` is positive, the edge is doubled for points far from all sensor
/// positions.
Cell find_cell(const glm::vec3& point, const NearestPlace<float>& sensors, const InitialiseOptions& options) {
    int level = 0;
    if (options.voxel_growth > 0.0) {
        const float nearest2 = sensors.squared_distance(point);
        const double edge = std::max(options.voxel_m, options.voxel_growth * std::sqrt(double(nearest2)));
        level = std::max(0, static_cast<int>(std::floor(std::log2(edge / options.voxel_m) + 0.5)));
    }
    const double edge = options.voxel_m * std::exp2(level);
    return {level, int(std::floor(point.x / edge)), int(std::floor(point.y / edge)),
            int(std::floor(point.z / edge))};
}

/// A sample with its voxel and its index among the samples of its frame.
struct Placed {
    Sample sample;
    Cell cell;
    std::uint32_t number;
};

// Number of hash tables of voxels. The hash of a voxel selects its table, so that threads
// can fill all tables in parallel.
constexpr std::size_t kParts = 32;
using PlacedByPart = std::array<std::vector<Placed>, kParts>;

PlacedByPart collect_samples(const Sequence& sequence, const Frame& frame,
                             const std::vector<BoxTrack>& separate, const NearestPlace<float>& sensors,
                             const InitialiseOptions& options) {
    PlacedByPart placed;
    std::uint32_t number = 0;
    for (const Sample& s : collect_frame_samples(sequence, frame, separate, options)) {
        const Cell cell = find_cell(s.position, sensors, options);
        placed[CellHash{}(cell) % kParts].push_back({s, cell, number++});
    }
    return placed;
}

/// One of the hash tables of voxels.
struct Voxels {
    std::unordered_map<Cell, std::size_t, CellHash> index;
    std::vector<Voxel> voxels;

    void add(const Placed& placed, std::size_t frame) {
        const auto [slot, is_new] = index.try_emplace(placed.cell, voxels.size());
        if (is_new) voxels.push_back({.first = std::uint64_t(frame) << 32 | placed.number});
        Voxel& v = voxels[slot->second];
        v.position += glm::dvec3(placed.sample.position);
        v.view += glm::dvec3(placed.sample.view);
        v.intensity += placed.sample.intensity;
        ++v.count;
    }
};

/// Returns the mean sample of each voxel, sorted by the first sample of the voxel. This
/// order does not depend on the threads. Reads only a few frames at a time, so that the
/// memory does not grow with the number of frames.
std::vector<Sample> compute_voxel_means(const Sequence& sequence, const std::vector<int>& train,
                                        const InitialiseOptions& options, const Progress& progress) {
    constexpr std::size_t kFrames = 16;
    const std::vector<BoxTrack> separate = list_foreground_boxes(sequence, options);
    const NearestPlace<float> sensors(list_sensor_positions(sequence, train));
    std::vector<Voxels> parts(kParts);
    for (std::size_t begin = 0; begin < train.size(); begin += kFrames) {
        if (progress) progress("points of the background", double(begin) / double(train.size()));
        std::vector<PlacedByPart> frames(std::min(kFrames, train.size() - begin));
        parallel_for(static_cast<int>(frames.size()), [&](int index) {
            frames[std::size_t(index)] =
                collect_samples(sequence, sequence.frames[std::size_t(train[begin + std::size_t(index)])],
                                separate, sensors, options);
        });
        parallel_for(kParts, [&](int part) {
            for (std::size_t i = 0; i < frames.size(); ++i)
                for (const Placed& placed : frames[i][std::size_t(part)])
                    parts[std::size_t(part)].add(placed, begin + i);
        });
    }
    if (progress) progress("points of the background", 1.0);
    std::vector<Voxel> voxels;
    for (Voxels& part : parts) {
        voxels.insert(voxels.end(), part.voxels.begin(), part.voxels.end());
        part = {};
    }
    parallel_sort(voxels, [](const Voxel& first, const Voxel& second) { return first.first < second.first; });
    std::vector<Sample> means;
    for (const Voxel& v : voxels)
        means.push_back({glm::vec3(v.position / double(v.count)), static_cast<float>(v.intensity / v.count),
                         glm::vec3(v.view / std::max(glm::length(v.view), 1e-12))});
    return means;
}

/// Removes samples at positions where other frames observe empty space. Such samples
/// belong to moving objects.
std::vector<Sample> remove_movers(const std::vector<Sample>& samples, const Sequence& sequence,
                                  const std::vector<int>& train, const Progress& progress) {
    Visibility visibility(sequence, train);
    std::vector<glm::vec3> points;
    for (const Sample& sample : samples) points.push_back(sample.position);
    visibility.request_images(points);
    std::vector<char> keep(samples.size());
    for_each_block_with_progress(samples.size(), progress, "removing moving points", [&](std::size_t index) {
        keep[index] = !visibility.count_votes(samples[index].position).is_seen_through(kGoneShare);
    });
    std::vector<Sample> kept;
    for (std::size_t i = 0; i < samples.size(); ++i)
        if (keep[i]) kept.push_back(samples[i]);
    return kept;
}

}  // namespace

Surfels initialise_background(const Sequence& sequence, const std::vector<int>& train_positions,
                              const InitialiseOptions& options, const Progress& progress) {
    std::vector<Sample> samples = compute_voxel_means(sequence, train_positions, options, progress);
    if (options.unlabelled_movers != UnlabelledMovers::background)
        samples = remove_movers(samples, sequence, train_positions, progress);
    if (samples.empty())
        throw DataError(
            fmt::format("cannot initialise the background of {}: none of its {} training frames has a return "
                        "outside moving boxes",
                        sequence.name, train_positions.size()));
    return make_surfels_from_points(samples, options, sequence.intensity_response.incidence, progress);
}

}  // namespace relidar
