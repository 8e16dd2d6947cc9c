// SPDX-License-Identifier: Apache-2.0
// Copies memory to measure the memory bandwidth. Each thread copies 16 bytes. Input:
// from. Output: to. Minimum traffic per thread: 16 B read, 16 B written.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
RELIDAR_PARAMS(CopyParams);

void main() {
    uint i = thread_index();
    if (i < params.n) params.to.at[i] = params.from.at[i];
}
