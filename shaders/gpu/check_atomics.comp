// SPDX-License-Identifier: Apache-2.0
// Adds small integers to float sums, so that the host can check the atomics of a device.
// Many threads add to each sum at the same time. The host knows each sum exactly.
// Accumulated: sums.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "relidar/base/atomic_add.glsl"
#include "shared/gpu.h"
RELIDAR_PARAMS(CheckAtomicsParams);

void main() {
    uint i = thread_index();
    if (i >= params.n) return;
    uint entry = i % params.n_sums;
    float amount = float(1u + i % RELIDAR_CHECK_AMOUNTS);
    if (params.fault != 0u) params.sums.at[entry] += amount;
    else atomic_add(params.sums, entry, amount);
}
