// SPDX-License-Identifier: Apache-2.0
// Makes a drive around a block with exact poses. It has straight roads, curves of 90
// degrees, a stop, and an end at which the vehicle observes the start again.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::test {

/// Makes a drive of 283 m around a block in n_frames sweeps at 10 Hz. The car stops for 2
/// s, and the drive ends slightly beyond its start. A sweep has 32 x 128 rays, a rolling
/// shutter, range noise of 1 cm, and no labels.
Log drive_around_block(int n_frames);

}  // namespace relidar::test
