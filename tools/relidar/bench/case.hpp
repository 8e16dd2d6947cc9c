// SPDX-License-Identifier: Apache-2.0
// Creates scenes and rays for benchmarks.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/run/run.hpp>

namespace relidar::cli {

/// Input of a benchmark: a scene, the rays that are cast into it, and the settings of the
/// GPU kernels.
struct BenchCase {
    /// Name in the report: "benchmark street", or the folder of the run and the frame
    /// number.
    std::string name;
    Scene scene;
    Config config;
    WorldRays rays;
    int rows = 0;
    int columns = 0;
    glm::vec3 view_origin_m{0.0f};
    std::vector<InstancePose> placed;  ///< [instances] pose of each instance.
};

/// Creates a benchmark with a synthetic street of `n_surfels` surfels and the settings of
/// the LiDAR-RT paper.
/// @param smaller_scales_for_more_surfels if true, the surfels become smaller as their
/// number grows
BenchCase make_synthetic_street_benchmark(std::uint32_t n_surfels, bool smaller_scales_for_more_surfels,
                                          const RayTable& rays);

/// Creates a benchmark from a trained run. Casts the rays of the run's sensor at the
/// first held-out frame.
/// @throws DataError if the run has no frames or no surfels
BenchCase make_benchmark_from_run(const TrainedRun& run);

}  // namespace relidar::cli
