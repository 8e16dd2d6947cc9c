// SPDX-License-Identifier: Apache-2.0
// Computes a lower bound for the time of each kernel: the number of bytes that it must
// read or write, divided by the measured copy bandwidth of the device. Ignores latency,
// divergence, arithmetic and repeated loads. A kernel can be faster than its bound if all
// data fit into the caches.
#pragma once

#include <map>
#include <string>

namespace relidar::cli {

/// Sizes of a benchmark scene, which decide the minimum memory traffic of each kernel.
struct MemoryTrafficSizes {
    double n_surfels = 0.0;
    double n_models = 1.0;
    double n_touched = 0.0;
    double n_rays = 0.0;
    double n_hits = 0.0;          ///< Total number of blended hits of all rays.
    double n_hits_written = 0.0;  ///< Number of hits that the forward pass stores.
    /// number of stored hits that the backward pass reads; it searches the others again
    double n_stored_hits_read = 0.0;
    double n_sh = 16.0;  ///< Number of active spherical harmonics per channel.
    bool sh_per_surfel = true;
    bool training = true;
    bool lists = false;  ///< If true, the forward pass writes lists of hits.
    /// If true, each hit stores its gradients, and a later kernel sums them. If false,
    /// hits add their gradients by atomic operations.
    bool gather = false;
    bool only_touched = false;
    bool boxes = true;  ///< If true, surfels are represented by boxes in the acceleration structure.
    /// True if kernels traverse the BVH instead of ray tracing hardware. The memory
    /// traffic of hardware traversal is unknown and not counted.
    bool software = true;
};

/// Returns the minimum memory traffic of each kernel in bytes. Counts only data that one
/// kernel writes and another reads. Leaves out driver kernels and very short kernels.
std::map<std::string, double> min_traffic_bytes(const MemoryTrafficSizes& sizes);

}  // namespace relidar::cli
