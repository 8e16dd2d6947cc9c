// SPDX-License-Identifier: Apache-2.0
// The least a kernel can take: the bytes it must move once, over what the device's own
// copy moves in the same run. Left out: latency, divergence, what a cache of finite size
// loads twice, and arithmetic. A floor says which kernel has the most to gain, not what
// can be had; a case that fits the caches can even lie below it.
#pragma once

#include <cstdint>
#include <map>
#include <string>

namespace relidar::cli {

/// What the bytes of a repetition follow from.
struct FloorSizes {
    double n_surfels = 0.0;
    double n_models = 1.0;
    double n_touched = 0.0;  ///< surfels with a gradient; 0 where there is no backward pass
    double n_rays = 0.0;
    double n_hits = 0.0;          ///< blended, of all rays
    double n_hits_written = 0.0;  ///< those that the forward pass keeps
    double n_hits_kept = 0.0;     ///< those that the backward pass reads instead of searching them again
    double n_sh = 16.0;           ///< active harmonics a channel
    bool sh_per_surfel = true;
    bool training = true;
    bool lists = false;   ///< of hits, in the forward pass
    bool gather = false;  ///< hit records instead of atomics
    bool only_touched = false;
    bool boxes = true;          ///< proxies
    bool software = true;       ///< traversal; the driver's structures are its own business
    double nodes_opened = 0.0;  ///< by all rays of the forward pass, 0 = not known
    double surfels_tested = 0.0;
};

/// Bytes of each row of a bench that must move once: in from memory where the kernel did
/// not make them, out where another reads them. Rows without a floor (the driver's, and
/// those too small to matter) are not in it.
std::map<std::string, double> floor_bytes(const FloorSizes& sizes);

/// What the tracing kernels ask of the caches: every visit and every hit counts. Empty
/// where visits are not counted.
std::map<std::string, double> cache_bytes(const FloorSizes& sizes);

/// Arithmetic of the forward pass's search, operations; 0 where visits are not counted.
double search_operations(const FloorSizes& sizes);

}  // namespace relidar::cli
