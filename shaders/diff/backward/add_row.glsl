// SPDX-License-Identifier: Apache-2.0
// Adds rows of 16 floats, one per lane, to rows of an array with atomics. Either each
// lane adds its row, or (COALESCED_ATOMICS) the lanes of a subgroup exchange their rows
// through shared memory, and neighbouring lanes add neighbouring floats of one row. The
// rays of a subgroup rarely hit the same surfel. If each lane adds its row, each of 16
// instructions touches one cache sector per lane. If lanes exchange rows, the same
// additions touch two sectors per row. Include this file after kernel.glsl and
// atomic_add.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#extension GL_KHR_shader_subgroup_basic : require
RELIDAR_CONSTANT(uint, COALESCED_ATOMICS, 0u);

const uint kNoRow = 0xffffffffu;
// Number of floats between two rows in shared memory. It is odd, so that lanes that
// access the same column of different rows use different memory banks.
const uint kRowPitch = 17u;
shared float shared_rows[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x * kRowPitch : 1u];
shared uint shared_targets[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x : 1u];

/// Returns true if all lanes of a subgroup must call add_row() together. The result is
/// the same for the full workgroup. Returns false for partial subgroups, because the
/// missing lanes would not add their floats.
bool rows_are_exchanged() {
    return COALESCED_ATOMICS != 0u && gl_NumSubgroups * gl_SubgroupSize == gl_WorkGroupSize.x;
}

uint shared_row_index() { return gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID; }

/// Adds to array[16 row + k]. The addition happens immediately or in the next add_row()
/// of the same row.
void add_float(Floats array, uint row, uint k, float amount) {
    if (rows_are_exchanged()) shared_rows[shared_row_index() * kRowPitch + k] = amount;
    else atomic_add(array, 16u * row + k, amount);
}

/// Adds the rows of the subgroup's lanes to the array if lanes exchange rows. All lanes
/// must then call it together.
/// @param row  row of this lane, or kNoRow if it has none
/// @param wanted  bit mask: bit k is set if float k has been set. The same for all lanes.
void add_row(Floats array, uint row, uint wanted) {
    if (!rows_are_exchanged()) return;
    shared_targets[shared_row_index()] = row;
    subgroupBarrier();
    // Groups of n lanes add n rows. Lane k % n adds float k of each row.
    uint n = min(16u, gl_SubgroupSize), lane = gl_SubgroupInvocationID % n;
    uint first = shared_row_index() - lane;
    for (uint from = first; from < first + n; ++from) {
        uint to = shared_targets[from];
        if (to == kNoRow) continue;
        for (uint k = lane; k < 16u; k += n) {
            float amount = shared_rows[from * kRowPitch + k];
            if ((wanted & (1u << k)) != 0u && amount != 0.0) atomic_add(array, 16u * to + k, amount);
        }
    }
    subgroupBarrier();  // before the next rows are written
}
#endif
