// SPDX-License-Identifier: Apache-2.0
// Adds one row of 16 floats per lane to the rows of an array, with atomics. Each lane may
// add its row alone. With COALESCED_ATOMICS, the lanes exchange rows through shared
// memory, and neighbouring lanes add neighbouring floats of one row.
//
// The exchange is faster on GPUs, because the rays of a subgroup rarely hit the same
// surfel. Without the exchange, each of 16 instructions touches one cache sector per
// lane. With the exchange, the same additions touch two sectors per row.
//
// Include this file after kernel.glsl and atomic_add.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#extension GL_KHR_shader_subgroup_basic : require
RELIDAR_CONSTANT(uint, COALESCED_ATOMICS, 0u);

const uint kNoRow = 0xffffffffu;
// Distance between two rows in shared memory, floats. With an odd number, lanes that read
// the same column of different rows access different memory banks.
const uint kRowPitch = 17u;
shared float shared_rows[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x * kRowPitch : 1u];
shared uint shared_targets[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x : 1u];

/// Returns true if the threads of a subgroup exchange their rows (16 floats per thread)
/// through shared memory before they add them to the array. All threads of the subgroup
/// must then call add_row(). Returns false if a subgroup is not full.
bool are_rows_exchanged() {
    return COALESCED_ATOMICS != 0u && gl_NumSubgroups * gl_SubgroupSize == gl_WorkGroupSize.x;
}

uint get_shared_row_index() { return gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID; }

/// Adds `amount` atomically to array[16 row + index]. If are_rows_exchanged() is true,
/// only stores it in shared memory. The caller must then call add_row() to add it.
void add_to_row_component(Floats array, uint row, uint index, float amount) {
    if (are_rows_exchanged()) shared_rows[get_shared_row_index() * kRowPitch + index] = amount;
    else atomic_add(array, 16u * row + index, amount);
}

/// Adds the rows of all lanes of the subgroup to the array. Does nothing if lanes do not
/// exchange rows. If they exchange rows, all lanes must call this function together.
/// @param row row of this lane, or kNoRow if this lane has no row
/// @param is_needed bit mask with bit k set if float k has a value. Must be equal in all
/// lanes
void add_row(Floats array, uint row, uint is_needed) {
    if (!are_rows_exchanged()) return;
    shared_targets[get_shared_row_index()] = row;
    subgroupBarrier();
    // Each lane has stored a row of 16 floats in shared memory. A group of n lanes adds
    // its n rows to `array` one by one. Neighbouring lanes add neighbouring floats.
    uint n = min(16u, gl_SubgroupSize), lane = gl_SubgroupInvocationID % n;
    uint first = get_shared_row_index() - lane;
    for (uint from = first; from < first + n; ++from) {
        uint to = shared_targets[from];
        if (to == kNoRow) continue;
        for (uint k = lane; k < 16u; k += n) {
            float amount = shared_rows[from * kRowPitch + k];
            if ((is_needed & (1u << k)) != 0u && amount != 0.0) atomic_add(array, 16u * to + k, amount);
        }
    }
    subgroupBarrier();  // waits before the next rows are written
}
#endif
