// SPDX-License-Identifier: Apache-2.0
// Adds a float to a buffer atomically. Uses the device's float atomics if it has them,
// otherwise compare-and-swap on the bits. Each kernel of the library is built in both
// variants (RELIDAR_FLOAT_ATOMICS), and the host selects the variant that the device
// supports. Compare-and-swap runs on every device.
#ifndef RELIDAR_INCLUDED_BASE_ATOMIC_ADD_GLSL
#define RELIDAR_INCLUDED_BASE_ATOMIC_ADD_GLSL
#include "relidar/base/kernel.glsl"

layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer AtomicFloats { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer AtomicBits { uint at[]; };

void atomic_add(Floats array, uint index, float amount) {
#ifdef RELIDAR_FLOAT_ATOMICS
    atomicAdd(AtomicFloats(uvec2(array)).at[index], amount);
#else
    AtomicBits bits = AtomicBits(uvec2(array));
    uint seen = bits.at[index];
    for (;;) {
        uint found = atomicCompSwap(bits.at[index], seen, floatBitsToUint(uintBitsToFloat(seen) + amount));
        if (found == seen) return;
        seen = found;
    }
#endif
}
#endif
