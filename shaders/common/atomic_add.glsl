// SPDX-License-Identifier: Apache-2.0
// Float atomic add on a buffer: the device's own where it has one, else compare-and-swap on the bits. Built both ways
// (RELIDAR_FLOAT_ATOMICS); which one runs follows the device.
#ifndef RELIDAR_INCLUDED_COMMON_ATOMIC_ADD_GLSL
#define RELIDAR_INCLUDED_COMMON_ATOMIC_ADD_GLSL

layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer AtomicFloat { float value; };
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer AtomicBits { uint value; };

void atomic_add(Floats array, uint index, float amount) {
    uint64_t address = uint64_t(array) + uint64_t(index) * 4ul;
#ifdef RELIDAR_FLOAT_ATOMICS
    AtomicFloat target = AtomicFloat(address);
    atomicAdd(target.value, amount);
#else
    AtomicBits target = AtomicBits(address);
    uint seen = target.value;
    for (;;) {
        uint found = atomicCompSwap(target.value, seen, floatBitsToUint(uintBitsToFloat(seen) + amount));
        if (found == seen) return;
        seen = found;
    }
#endif
}
#endif
