// SPDX-License-Identifier: Apache-2.0
// Creates the scenes and rays that `relidar-dev bench` measures. The scene is a benchmark
// street or a trained run. A run is rendered with the sensor of its log.
#pragma once

#include <string>

#include <relidar/diff/accel.hpp>

#include "bench/case.hpp"

namespace relidar::cli {

/// Options of the command line that describe the case.
struct BenchChoice {
    /// Kind of benchmark street. In "A", the size of the surfels does not depend on their
    /// number. In "B", a larger number of surfels makes each surfel smaller. "C" is like
    /// "B", but all surfels have opacity 0.1.
    std::string street = "A";
    long long n_surfels = 100000;
    std::string rays = "64x1024";  ///< "waymo", "kitti" or "ROWSxCOLUMNS".
    std::string run;               ///< run folder; if it is set, the run is measured instead of the street
    /// Values that replace settings of the case. An empty text leaves the setting
    /// unchanged.
    std::string chunk, proxy, walk, order, sh, keep_hits;
    std::string likelihood;  ///< Weight of the likelihood loss. An empty text leaves it unchanged.
    /// If true, gradients are gathered and not added by atomic operations. This overrides
    /// the setting of the case.
    bool deterministic = false;
};

/// A case with additional options that are not settings of a run.
struct DevCase : BenchCase {
    Proxy proxy = Proxy::automatic;
    Walk walk = Walk::automatic;
    HitOrder order = HitOrder::automatic;
    /// If true, the number of stored hits per ray grows beyond config.trace.keep_hits if
    /// needed. Training does the same.
    bool keeps_more_hits = true;
};

/// Returns the options for building and traversing the acceleration structure.
AccelOptions make_accel_options(const DevCase& bench);
TraceOptions trace_of(const DevCase& bench);

/// Checks all options before a scene is created.
/// @throws UsageError that names the first invalid option
void check(const BenchChoice& choice);

/// Creates the scene and the rays that the user has chosen.
/// @throws DataError if the run cannot be read
DevCase make_case(const BenchChoice& choice);

}  // namespace relidar::cli
