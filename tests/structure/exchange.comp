// SPDX-License-Identifier: Apache-2.0
// Threads exchange values through a buffer, coherently only if COHERENT is defined.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../shaders/base/kernel.glsl"
#include "relidar/base/lang.h"
struct ExchangeParams {
    Uints keys;    // read and written
    Uints source;  // read only
    Uints result;  // written only
};
RELIDAR_PARAMS(ExchangeParams);
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer SharedUints { uint at[]; };

#ifdef COHERENT
#define KEYS SharedUints(uvec2(params.keys))
#else
#define KEYS params.keys
#endif

void main() {
    uint i = gl_LocalInvocationIndex;
    KEYS.at[i] = params.source.at[i];
    memoryBarrierBuffer();
    barrier();
    params.result.at[i] = KEYS.at[i ^ 1u];
}
