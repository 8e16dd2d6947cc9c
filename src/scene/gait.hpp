// SPDX-License-Identifier: Apache-2.0
// People and cyclists that walk: how far they have come, how long a stride is, and
// surfels that take part in it (docs/method.md M14). Private to scene.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/point_surfels.hpp"

namespace relidar {

/// How far something has come along its track. Positions are averaged over a second,
/// since labels jitter, and what is slower than 0.2 m/s stands.
class WalkedWay {
public:
    explicit WalkedWay(const PoseTrack& world_from_box);
    /// Metres since the first pose; outside the track as fast as at its end.
    double at(double t_s) const;

private:
    std::vector<double> time_s_, walked_m_;
};

/// Ways that one turn of a gait may take.
struct StrideRange {
    double least_m, most_m;
};
/// Of things of a kind that bend; nothing where they are rigid.
std::optional<StrideRange> stride_range(ObjectKind kind);

/// A stride, or why there is none.
struct FoundStride {
    double stride_m = 0.0;  ///< 0: none
    std::string why_none = {};
};
/// The stride at which points of one moment lie nearest to those of the same phase in
/// other turns.
/// @param samples  in the frame of the box, with what was walked until then
FoundStride find_stride(const std::vector<Sample>& samples, const StrideRange& range);

/// Surfels of something that walks: where points lie at every phase they rest, others are
/// there around their own phase and swing as the points beside them do. @param samples
/// at least one @param most  surfels @param progress  what it throws ends it
Surfels surfels_that_walk(const std::vector<Sample>& samples, double stride_m,
                          const InitialiseOptions& options, double incidence, std::size_t most,
                          const Progress& progress = {});

}  // namespace relidar
