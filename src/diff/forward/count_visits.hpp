// SPDX-License-Identifier: Apache-2.0
// Counts the tree nodes and surfels that the software traversal visits, for benchmarks.
#pragma once

#include <optional>

#include <relidar/diff/forward.hpp>

namespace relidar {

/// Mean numbers of tree nodes and surfels that a ray visits. With
/// BvhTraversalMode::subgroup, the rays of a subgroup visit nodes together, and each ray
/// counts all these visits.
struct VisitCounts {
    double nodes = 0.0;    ///< visited nodes, including nodes of the top-level tree
    double surfels = 0.0;  ///< tested surfels
};
/// Renders a batch again, and returns how many tree nodes and surfels the rays visit.
/// Waits for the result. Before the call, submit the commands that compute the surfel
/// records and build the acceleration structure.
/// @return nothing if the device uses ray queries, because the driver reports no visits
std::optional<VisitCounts> count_visits(Device& device, const DeviceScene& scene,
                                        const AccelerationStructure& accel, const RayBatch& batch,
                                        const ImageModel& model, const TraceOptions& options);

}  // namespace relidar
