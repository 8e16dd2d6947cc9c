// SPDX-License-Identifier: Apache-2.0
// Counts the tree nodes and surfels that the software traversal visits, for benchmarks.
#pragma once

#include <optional>

#include <relidar/diff/forward.hpp>

namespace relidar {

/// Mean number of visited nodes and surfels per ray of a batch. With Walk::subgroup, each
/// ray counts everything that its subgroup visits.
struct VisitCounts {
    double nodes = 0.0;    ///< visited nodes, including nodes of the top-level tree
    double surfels = 0.0;  ///< tested surfels
};
/// Renders a batch again, counts at most 2^32 visits, and waits for the result. The scene
/// must be activated and the acceleration structure updated, and both must be submitted.
/// @return nothing if the device uses ray queries, because the driver reports no visits
std::optional<VisitCounts> count_visits(Device& device, const DeviceScene& scene, const Accel& accel,
                                        const RayBatch& batch, const ImageModel& model,
                                        const TraceOptions& options);

}  // namespace relidar
