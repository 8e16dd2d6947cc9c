// SPDX-License-Identifier: Apache-2.0
// Reads and writes the spherical-harmonic coefficients of one surfel per thread, one
// channel at a time.
//
// On a GPU, neighbouring threads would access addresses 192 bytes apart, which is slow.
// Therefore, if STAGED is set, all threads of a workgroup together copy a channel of all
// their surfels to shared memory, with neighbouring addresses.
//
// Include this file after kernel.glsl and shared/scene.h.
#ifndef RELIDAR_INCLUDED_SCENE_SH_ROWS_GLSL
#define RELIDAR_INCLUDED_SCENE_SH_ROWS_GLSL
RELIDAR_CONSTANT(bool, STAGED, false);

// Number of floats per surfel in shared memory. An odd number makes neighbouring surfels
// use different memory banks.
const uint kChannelPitch = 17u;
shared float staged_channel[gl_WorkGroupSize.x * kChannelPitch];
shared bool staged_loads[gl_WorkGroupSize.x], staged_stores[gl_WorkGroupSize.x];

/// Sets whether the coefficients of this thread's surfel are loaded and stored. All
/// threads of the workgroup must call this function, load_sh_channel() and
/// store_channel().
void set_sh_access(bool loads_coefficients, bool stores_coefficients) {
    if (!STAGED) return;
    staged_loads[gl_LocalInvocationIndex] = loads_coefficients;
    staged_stores[gl_LocalInvocationIndex] = stores_coefficients;
}

/// Loads the first `n_coefficients` coefficients of a channel of a surfel.
void load_sh_channel(Floats sh, uint surfel, uint channel, uint n_coefficients) {
    if (!STAGED) return;
    barrier();  // Waits until all threads have stored the previous channel.
    uint first = surfel - gl_LocalInvocationIndex, k = gl_LocalInvocationIndex % 16u;
    float moved[16];  // Starts all loads before the first value is used, so that the loads overlap.
    [[unroll]] for (uint m = 0u; m < 16u; ++m) {
        uint s = (m * gl_WorkGroupSize.x + gl_LocalInvocationIndex) / 16u;
        moved[m] = k < n_coefficients && staged_loads[s]
                       ? sh.at[(first + s) * RELIDAR_SH_FLOATS + channel * 16u + k]
                       : 0.0;
    }
    [[unroll]] for (uint m = 0u; m < 16u; ++m)
        staged_channel[(m * gl_WorkGroupSize.x + gl_LocalInvocationIndex) / 16u * kChannelPitch + k] =
            moved[m];
    barrier();
}

/// Stores the coefficients that set_coefficient() has written.
void store_channel(Floats sh, uint surfel, uint channel, uint n_coefficients) {
    if (!STAGED) return;
    barrier();
    uint first = surfel - gl_LocalInvocationIndex;
    for (uint e = gl_LocalInvocationIndex; e < 16u * gl_WorkGroupSize.x; e += gl_WorkGroupSize.x) {
        uint s = e / 16u, k = e % 16u;
        if (k < n_coefficients && staged_stores[s])
            sh.at[(first + s) * RELIDAR_SH_FLOATS + channel * 16u + k] =
                staged_channel[s * kChannelPitch + k];
    }
}

/// Returns SH coefficient `index`. The last call of load_sh_channel() must be for
/// `channel`.
float load_sh_value(Floats sh, uint surfel, uint channel, uint index) {
    return STAGED ? staged_channel[gl_LocalInvocationIndex * kChannelPitch + index]
                  : sh.at[surfel * RELIDAR_SH_FLOATS + channel * 16u + index];
}

void set_coefficient(Floats sh, uint surfel, uint channel, uint index, float value) {
    if (STAGED) staged_channel[gl_LocalInvocationIndex * kChannelPitch + index] = value;
    else sh.at[surfel * RELIDAR_SH_FLOATS + channel * 16u + index] = value;
}
#endif
