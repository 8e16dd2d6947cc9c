// SPDX-License-Identifier: Apache-2.0
// The scenes and rays that `relidar-dev bench` measures: a benchmark street, or a trained
// run seen by its own sensor.
#pragma once

#include <string>

#include <relidar/diff/accel.hpp>

#include "bench/case.hpp"

namespace relidar::cli {

/// The case as given on the command line.
struct BenchChoice {
    /// Kind of street. A: the size of surfels does not depend on their number. B: more
    /// surfels are smaller. C: as B, with opacity 0.1 for all surfels.
    std::string street = "A";
    long long n_surfels = 100000;
    std::string rays = "64x1024";  ///< "waymo", "kitti" or "ROWSxCOLUMNS".
    std::string run;               ///< Run folder that replaces the street.
    /// Settings that replace those of the case. Empty: unchanged.
    std::string chunk, proxy, walk, order, sh, keep_hits;
    std::string likelihood;      ///< weight of this loss, likewise
    bool deterministic = false;  ///< gradients are gathered, whatever the case says
};

/// A case with options that no setting offers.
struct DevCase : BenchCase {
    Proxy proxy = Proxy::automatic;
    Walk walk = Walk::automatic;
    HitOrder order = HitOrder::automatic;
    /// True: the number of stored hits grows beyond config.trace.keep_hits, as it does
    /// during training.
    bool keeps_more_hits = true;
};

/// Options of the acceleration structure and of the traversal for rendering.
AccelOptions accel_of(const DevCase& bench);
TraceOptions trace_of(const DevCase& bench);

/// Checks every option without creating anything.
/// @throws UsageError that names the first invalid option
void check(const BenchChoice& choice);

/// Creates the scene and rays of a choice.
/// @throws DataError if the run cannot be read
DevCase make_case(const BenchChoice& choice);

}  // namespace relidar::cli
