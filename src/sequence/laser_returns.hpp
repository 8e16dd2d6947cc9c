// SPDX-License-Identifier: Apache-2.0
// Returns of a log for comparing lasers. Private to sequence.
#pragma once

#include <vector>

#include <relidar/sequence.hpp>

#include "core/parallel.hpp"

namespace relidar {

/// Whether a ray returned from within max_range_m and was fired by a laser that the sensor knows.
inline bool is_of_laser(const Sequence& sequence, const Scan& scan, std::size_t ray, double max_range_m) {
    return scan.range_m[ray] > 0.0f && scan.range_m[ray] < max_range_m && scan.rays.channel[ray] < sequence.sensor.beams.size();
}

/// read(frame) of the frames at some positions; of every n-th, where all of them have more than most_rays rays.
template <class Read>
auto read_frames(const Sequence& sequence, const std::vector<int>& positions, std::size_t most_rays, const Read& read) {
    std::size_t rays = 0;
    for (const int position : positions) rays += sequence.frames[std::size_t(position)].scan.range_m.size();
    const std::size_t stride = rays / most_rays + 1;
    std::vector<decltype(read(sequence.frames.front()))> frames((positions.size() + stride - 1) / stride);
    run_parallel(static_cast<int>(frames.size()), [&](int i) { frames[std::size_t(i)] = read(sequence.frames[std::size_t(positions[std::size_t(i) * stride])]); });
    return frames;
}

}  // namespace relidar
