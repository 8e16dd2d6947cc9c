// SPDX-License-Identifier: Apache-2.0
// Copies, to measure what memory moves. One thread 16 bytes.
// Input: from. Output: to. Floor: 16 B read, 16 B written.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "shared/gpu.h"
RELIDAR_PARAMS(CopyParams);

void main() {
    uint i = thread_index();
    if (i < params.n) params.to.at[i] = params.from.at[i];
}
