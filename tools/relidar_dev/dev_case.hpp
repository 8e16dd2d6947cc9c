// SPDX-License-Identifier: Apache-2.0
// What `relidar-dev bench` measures: a benchmark street with its rays, or a trained run
// seen by its own sensor.
#pragma once

#include <string>

#include <relidar/diff/accel.hpp>

#include "bench/case.hpp"

namespace relidar::cli {

/// The case as asked for on the command line.
struct BenchChoice {
    /// A: surfels of one size however many; B: smaller the more there are; C: as B, all
    /// of opacity 0.1
    std::string street = "A";
    long long n_surfels = 100000;
    std::string rays = "64x1024";  ///< waymo, kitti or ROWSxCOLUMNS
    std::string run;               ///< a run folder instead of a street
    /// settings over those of the case; empty = as they are
    std::string chunk, proxy, walk, order, sh, keep_hits;
    std::string likelihood;      ///< weight of this loss, likewise
    bool deterministic = false;  ///< gradients are gathered, whatever the case says
};

/// A case with choices that no setting offers.
struct DevCase : BenchCase {
    Proxy proxy = Proxy::automatic;
    Walk walk = Walk::automatic;
    HitOrder order = HitOrder::automatic;
    bool keeps_more_hits = true;  ///< than config.trace.keep_hits, as a training comes to
};

/// What the device searches, and how, in rendering.
AccelOptions accel_of(const DevCase& bench);
TraceOptions trace_of(const DevCase& bench);

/// Looks at every option without making anything. @throws UsageError naming the first one
/// that makes no sense
void check(const BenchChoice& choice);

/// @throws DataError where the run cannot be read
DevCase make_case(const BenchChoice& choice);

}  // namespace relidar::cli
