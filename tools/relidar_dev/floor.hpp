// SPDX-License-Identifier: Apache-2.0
// Lower bound for the time of each kernel: the bytes that it must move once, divided by
// the copy bandwidth of the device in the same run. Ignores latency, divergence, repeated
// loads of a finite cache, and arithmetic. The bound shows which kernel has the most room
// for improvement. A case that fits into the caches can be faster than its bound.
#pragma once

#include <cstdint>
#include <map>
#include <string>

namespace relidar::cli {

/// Sizes that determine the bytes of one repetition.
struct FloorSizes {
    double n_surfels = 0.0;
    double n_models = 1.0;
    double n_touched = 0.0;  ///< Number of surfels with a gradient. 0 without a backward pass.
    double n_rays = 0.0;
    double n_hits = 0.0;          ///< Number of blended hits of all rays.
    double n_hits_written = 0.0;  ///< Number of hits that the forward pass stores.
    /// Number of stored hits that the backward pass reads instead of searching again.
    double n_hits_kept = 0.0;
    double n_sh = 16.0;  ///< Active spherical harmonics per channel.
    bool sh_per_surfel = true;
    bool training = true;
    bool lists = false;   ///< True: the forward pass writes lists of hits.
    bool gather = false;  ///< True: hit records replace atomics.
    bool only_touched = false;
    bool boxes = true;          ///< True: proxies of surfels are boxes.
    bool software = true;       ///< True: software traversal. The driver's structures are not modelled.
    double nodes_opened = 0.0;  ///< Number of nodes opened by all rays of the forward pass. 0: unknown.
    double surfels_tested = 0.0;
};

/// Returns, for each row of a benchmark, the bytes that must move once. They are reads of
/// data that the kernel did not produce and writes that another kernel reads. Rows
/// without a bound are left out: those of the driver, and those too small to matter.
std::map<std::string, double> floor_bytes(const FloorSizes& sizes);

/// Returns the bytes that the tracing kernels load from the caches, counting every visit
/// and every hit. Returns an empty map if visits are not counted.
std::map<std::string, double> cache_bytes(const FloorSizes& sizes);

/// Returns the number of arithmetic operations of the search in the forward pass, or 0 if
/// visits are not counted.
double search_operations(const FloorSizes& sizes);

}  // namespace relidar::cli
