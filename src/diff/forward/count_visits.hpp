// SPDX-License-Identifier: Apache-2.0
// Counts what the software traversal visits, for benchmarks.
#pragma once

#include <optional>

#include <relidar/diff/forward.hpp>

namespace relidar {

/// What the software traversal looks at for a ray, on average over a batch, all passes
/// counted. With Walk::subgroup a ray counts what its subgroup opened for it.
struct VisitCounts {
    double nodes = 0.0;    ///< nodes opened, of the top tree too
    double surfels = 0.0;  ///< surfels tested
};
/// Renders a batch again and counts the visits, at most 2^32. The scene must be
/// activated, accel updated, and both submitted. Blocks.
/// @return nothing if the device traverses by ray query, because the driver reports no
/// visits
std::optional<VisitCounts> count_visits(Device& device, const DeviceScene& scene, const Accel& accel,
                                        const RayBatch& batch, const ImageModel& model,
                                        const TraceOptions& options);

}  // namespace relidar
