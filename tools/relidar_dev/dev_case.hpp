// SPDX-License-Identifier: Apache-2.0
// Creates the scenes and rays that `relidar-dev bench` measures. The scene is a benchmark
// street or a trained run. A run is rendered with the sensor of its log.
#pragma once

#include <string>

#include <relidar/diff/accel.hpp>

#include "bench/case.hpp"

namespace relidar::cli {

struct BenchCaseOptions {
    /// Kind of benchmark street. "A": the size of a surfel does not depend on
    /// `n_surfels`. "B": surfels are smaller if `n_surfels` is larger. "C": like "B", but
    /// all surfels have opacity 0.1.
    std::string street = "A";
    long long n_surfels = 100000;
    std::string rays = "64x1024";  ///< "waymo", "kitti" or "ROWSxCOLUMNS".
    std::string run;               ///< run folder; if it is set, the run is measured instead of the street
    /// values that override settings of the benchmark; empty: unchanged
    std::string chunk, proxy, traversal_mode, order, sh, keep_hits;
    /// If true, gradients are summed in a fixed order instead of by atomic operations.
    /// Overrides the setting of the benchmark.
    bool deterministic = false;
};

/// Input of a benchmark, with additional options that are not settings of a training.
struct DevCase : BenchCase {
    ProxyShape proxy = ProxyShape::automatic;
    BvhTraversalMode traversal_mode = BvhTraversalMode::automatic;
    HitSortMethod order = HitSortMethod::automatic;
    /// If true and many rays have more than config.trace.keep_hits hits, the forward pass
    /// stores more hits per ray than this setting says. Training also does this.
    bool keeps_more_hits = true;
};

TraceOptions trace_options(const DevCase& setup);

/// Checks all options before a scene is created.
/// @throws UsageError that names the first invalid option
void check_options(const BenchCaseOptions& choice);

DevCase make_case(const BenchCaseOptions& choice);

}  // namespace relidar::cli
