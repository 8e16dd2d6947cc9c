// SPDX-License-Identifier: Apache-2.0
// Float atomic add on a buffer: the device's own where it has one, else compare-and-swap
// on the bits. Built both ways (RELIDAR_FLOAT_ATOMICS); which one runs follows the
// device.
#ifndef RELIDAR_INCLUDED_BASE_ATOMIC_ADD_GLSL
#define RELIDAR_INCLUDED_BASE_ATOMIC_ADD_GLSL

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
