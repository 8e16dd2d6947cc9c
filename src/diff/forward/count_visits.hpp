// SPDX-License-Identifier: Apache-2.0
// Counts the tree nodes and surfels that the software traversal visits, for benchmarks.
#pragma once

#include <optional>

#include <relidar/diff/forward.hpp>

namespace relidar {

/// Average number of visits per ray of a batch, over all passes. With Walk::subgroup, a
/// ray counts everything that its subgroup visits.
struct VisitCounts {
    double nodes = 0.0;    ///< visited nodes, including the top tree
    double surfels = 0.0;  ///< tested surfels
};
/// Renders a batch again and counts up to 2^32 visits. The scene must be activated, the
/// acceleration structure updated, and both submitted. Blocks.
/// @return nothing if the device uses ray query, because the driver reports no visits
std::optional<VisitCounts> count_visits(Device& device, const DeviceScene& scene, const Accel& accel,
                                        const RayBatch& batch, const ImageModel& model,
                                        const TraceOptions& options);

}  // namespace relidar
