// SPDX-License-Identifier: Apache-2.0
// What the software traversal costs, for benchmarks. Not installed.
#pragma once

#include <optional>

#include <relidar/stages/forward.hpp>

namespace relidar {

/// What the software traversal looks at for a ray, on average over a batch, all passes counted. With Walk::subgroup a ray counts what its
/// subgroup opened for it.
struct VisitCounts {
    double nodes = 0.0;     ///< nodes opened, of the top tree too
    double surfels = 0.0;   ///< surfels tested
};
/// Counts by rendering a batch once more. The scene must have been activated and accel updated, and both submitted. Blocks; at most
/// 2^32 visits. @return nothing where the device traverses by ray query: its driver does not say
std::optional<VisitCounts> count_visits(Device& device, const DeviceScene& scene, const Accel& accel, const RayBatch& batch,
                                        const ImageModel& model, const TraceOptions& options);

}  // namespace relidar
