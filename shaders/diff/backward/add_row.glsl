// SPDX-License-Identifier: Apache-2.0
// Adds one row of 16 floats per lane to the rows of an array, with atomics. Each lane may
// add its row alone. With COALESCED_ATOMICS, lanes exchange rows through shared memory,
// and neighbouring lanes add neighbouring floats of one row. This is faster on GPUs: two
// cache sectors per row instead of one per lane and instruction. Include this file after
// kernel.glsl and atomic_add.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
RELIDAR_CONSTANT(uint, COALESCED_ATOMICS, 0u);

const uint kNoRow = 0xffffffffu;
// Distance between two rows in shared memory, floats. With an odd number, lanes that read
// the same column of different rows access different memory banks.
const uint kRowPitch = 17u;
shared float shared_rows[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x * kRowPitch : 1u];
shared uint shared_targets[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x : 1u];

/// Returns true if the threads of a subgroup exchange their rows (16 floats per thread)
/// through shared memory before they add them to the array. All threads of the subgroup
/// must then call add_rows(). Returns false if a subgroup is not full.
bool exchanges_rows() {
    return COALESCED_ATOMICS != 0u && gl_NumSubgroups * gl_SubgroupSize == gl_WorkGroupSize.x;
}

uint shared_row() { return gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID; }

/// Adds `amount` atomically to array[16 row + index]. If exchanges_rows() is true, only
/// stores it in shared memory. The caller must then call add_rows() to add it.
void add_to_row(Floats array, uint row, uint index, float amount) {
    if (exchanges_rows()) shared_rows[shared_row() * kRowPitch + index] = amount;
    else atomic_add(array, 16u * row + index, amount);
}

/// Adds the rows of all lanes of the subgroup to the array. Does nothing if lanes do not
/// exchange rows. If they exchange rows, all lanes must call this function together.
/// @param target_row row of this lane, or kNoRow if this lane has no row
/// @param float_mask bit mask with bit k set if float k has a value. Must be equal in all
/// lanes
void add_rows(Floats array, uint target_row, uint float_mask) {
    if (!exchanges_rows()) return;
    shared_targets[shared_row()] = target_row;
    subgroupBarrier();
    // Each lane has stored a row of 16 floats in shared memory. A group of n lanes adds
    // its n rows to `array` one by one. Neighbouring lanes add neighbouring floats.
    uint n = min(16u, gl_SubgroupSize), lane = gl_SubgroupInvocationID % n;
    uint first = shared_row() - lane;
    for (uint from = first; from < first + n; ++from) {
        uint to = shared_targets[from];
        if (to == kNoRow) continue;
        for (uint k = lane; k < 16u; k += n) {
            float amount = shared_rows[from * kRowPitch + k];
            if ((float_mask & (1u << k)) != 0u && amount != 0.0) atomic_add(array, 16u * to + k, amount);
        }
    }
    subgroupBarrier();  // waits before the next rows are written
}
#endif
