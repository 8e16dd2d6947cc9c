// SPDX-License-Identifier: Apache-2.0
// Collects the returns of a log for the comparison of beams. Used only in
// src/log/calibration.
#pragma once

#include <vector>

#include <relidar/log/log.hpp>

#include "base/parallel.hpp"

namespace relidar {

/// Calls visit(ray, beam, place) for each ray of a frame that a known beam has measured
/// and that has a return closer than max_range_m. The beam has the number of
/// Log::find_global_beam().
template <class Visit>
void visit_returns(const Log& log, const Frame& frame, double max_range_m, const Visit& visit) {
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        const float range_m = frame.scan.range_m[ray];
        if (!(range_m > 0.0f && range_m < max_range_m)) continue;
        if (const auto beam = log.find_global_beam(frame.lidar, frame.scan.rays.channel[ray]))
            visit(ray, *beam, locate_return(log, frame, ray));
    }
}

/// Returns the beams of all LiDARs, in the order of visit_returns().
inline std::vector<Beam*> list_beams(Log& log) {
    std::vector<Beam*> beams;
    for (Lidar& lidar : log.lidars)
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

/// A return in a grid cell. Intensities of returns in the same cell are compared.
struct CellReturn {
    std::uint32_t cell = 0;
    std::uint32_t beam;
    float range_m;
    float cosine = 0.0f;  ///< cosine of the angle of incidence
    float intensity;      ///< measured intensity
};

/// LiDAR returns, sorted by grid cell. Cells with a single return are left out. Cell
/// indices range from 0 to n_cells - 1, with gaps.
struct CellReturns {
    std::vector<CellReturn> sorted_returns;
    std::size_t n_cells = 0;
};
/// Collects the returns of all grid cells with at least two returns, because only
/// intensities in the same cell can be compared. Leaves out returns that are not on a
/// plane. If there are too many rays, uses only every n-th frame.
/// @param frames  indices in log.frames
CellReturns collect_cells(const Log& log, const std::vector<int>& frames);

}  // namespace relidar
