// SPDX-License-Identifier: Apache-2.0
// Spherical-harmonic coefficients of one surfel a thread, channel by channel. On a CPU a
// thread reads its own row. On a GPU neighbouring threads would then be 192 bytes apart,
// so there (STAGED) the threads of a workgroup move a channel of all their surfels
// together, neighbours at neighbouring addresses, and hand it over in shared memory.
// Include after kernel.glsl and shared/scene.h.
#ifndef RELIDAR_INCLUDED_SCENE_SH_ROWS_GLSL
#define RELIDAR_INCLUDED_SCENE_SH_ROWS_GLSL
RELIDAR_CONSTANT(bool, STAGED, false);

// floats a surfel: odd, so that the same coefficient of neighbouring surfels lies in
// different banks
const uint kChannelPitch = 17u;
shared float staged_channel[gl_WorkGroupSize.x * kChannelPitch];
shared bool staged_loads[gl_WorkGroupSize.x], staged_stores[gl_WorkGroupSize.x];

/// Whether the channels of this thread's surfel are loaded and stored. Every thread of
/// the workgroup must call it, as the next two, once.
void choose_moves(bool loads, bool stores) {
    if (!STAGED) return;
    staged_loads[gl_LocalInvocationIndex] = loads;
    staged_stores[gl_LocalInvocationIndex] = stores;
}

/// Makes the first n coefficients of a channel readable.
void load_channel(Floats sh, uint surfel, uint channel, uint n) {
    if (!STAGED) return;
    barrier();  // the moves are chosen, the channel before has been stored
    uint first = surfel - gl_LocalInvocationIndex, k = gl_LocalInvocationIndex % 16u;
    float moved[16];  // all of them are asked for before any is waited for
    [[unroll]] for (uint m = 0u; m < 16u; ++m) {
        uint s = (m * gl_WorkGroupSize.x + gl_LocalInvocationIndex) / 16u;
        moved[m] =
            k < n && staged_loads[s] ? sh.at[(first + s) * RELIDAR_SH_FLOATS + channel * 16u + k] : 0.0;
    }
    [[unroll]] for (uint m = 0u; m < 16u; ++m)
        staged_channel[(m * gl_WorkGroupSize.x + gl_LocalInvocationIndex) / 16u * kChannelPitch + k] =
            moved[m];
    barrier();
}

/// Writes what set_coefficient() left of it.
void store_channel(Floats sh, uint surfel, uint channel, uint n) {
    if (!STAGED) return;
    barrier();
    uint first = surfel - gl_LocalInvocationIndex;
    for (uint e = gl_LocalInvocationIndex; e < 16u * gl_WorkGroupSize.x; e += gl_WorkGroupSize.x) {
        uint s = e / 16u, k = e % 16u;
        if (k < n && staged_stores[s])
            sh.at[(first + s) * RELIDAR_SH_FLOATS + channel * 16u + k] =
                staged_channel[s * kChannelPitch + k];
    }
}

/// Coefficient k of the channel loaded last.
float coefficient(Floats sh, uint surfel, uint channel, uint k) {
    return STAGED ? staged_channel[gl_LocalInvocationIndex * kChannelPitch + k]
                  : sh.at[surfel * RELIDAR_SH_FLOATS + channel * 16u + k];
}

void set_coefficient(Floats sh, uint surfel, uint channel, uint k, float value) {
    if (STAGED) staged_channel[gl_LocalInvocationIndex * kChannelPitch + k] = value;
    else sh.at[surfel * RELIDAR_SH_FLOATS + channel * 16u + k] = value;
}
#endif
