// SPDX-License-Identifier: Apache-2.0
// A drive around a block with exact poses: straights, curves of 90 degrees, a stop, and
// the start seen again at the end.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::test {

/// The sensor does 283 m around a block in n_frames sweeps at 10 Hz, with a stop of 2 s,
/// and ends a little beyond where it began. 32 x 256 rays, rolling shutter, ranges with 1
/// cm of noise, no label.
Sequence drive_around_block(int n_frames);

}  // namespace relidar::test
