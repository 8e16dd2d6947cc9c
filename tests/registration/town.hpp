// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::test {

/// Makes a drive of 283 m around a block in n_frames sweeps at 10 Hz: straight roads,
/// curves, a stop of 2 s, and an end slightly beyond the start. A sweep has 32 x 128
/// rays, a rolling shutter, range noise of 1 cm, and no labels.
Log drive_around_block(int n_frames);

}  // namespace relidar::test
