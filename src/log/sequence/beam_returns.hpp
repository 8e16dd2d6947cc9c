// SPDX-License-Identifier: Apache-2.0
// Reads the returns of a log for the comparison of beams. Used only in src/log/sequence.
#pragma once

#include <optional>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "base/parallel.hpp"

namespace relidar {
/// Returns the number of the beam that measured a ray (find_global_beam()), or
/// nothing if the ray has no return closer than max_range_m.
inline std::optional<std::uint16_t> beam_of_return(const Log& sequence, const Frame& frame, std::size_t ray,
                                                   double max_range_m) {
    const float range_m = frame.scan.range_m[ray];
    return range_m > 0.0f && range_m < max_range_m
               ? sequence.find_global_beam(frame.lidar, frame.scan.rays.channel[ray])
               : std::nullopt;
}

/// Returns the beams of all LiDARs, in the order of beam_of_return().
inline std::vector<Beam*> list_beams(Log& sequence) {
    std::vector<Beam*> beams;
    for (Lidar& lidar : sequence.lidars)
        for (Beam& beam : lidar.sensor.beams) beams.push_back(&beam);
    return beams;
}

/// Calls process(frame) for frames and returns the results. If all frames together
/// have more than max_rays rays, processes only every n-th frame.
template <class Read>
auto map_frames(const Log& log, const std::vector<int>& selected, std::size_t max_rays, const Read& process) {
    std::size_t rays = 0;
    for (const int position : selected) rays += log.frames[std::size_t(position)].scan.range_m.size();
    const std::size_t stride = rays / max_rays + 1;
    std::vector<decltype(process(log.frames.front()))> frames((selected.size() + stride - 1) / stride);
    parallel_for(static_cast<int>(frames.size()), [&](int index) {
        frames[std::size_t(index)] = process(log.frames[std::size_t(selected[std::size_t(index) * stride])]);
    });
    return frames;
}

}  // namespace relidar
