// SPDX-License-Identifier: Apache-2.0
// Adds rows of 16 floats, one a lane, to rows of an array with atomics. Either each lane
// adds its own, or (COALESCED_ATOMICS) the lanes of a subgroup exchange their rows
// through shared memory, and neighbouring lanes add neighbouring floats of one row. At
// the same hit the rays of a subgroup rarely meet the same surfel: if each lane adds its
// own row, each of 16 instructions touches as many cache sectors as there are lanes; if
// they exchange rows, the same adds touch two sectors a row. Include after kernel.glsl
// and atomic_add.glsl.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_ADD_ROW_GLSL
#extension GL_KHR_shader_subgroup_basic : require
RELIDAR_CONSTANT(uint, COALESCED_ATOMICS, 0u);

const uint kNoRow = 0xffffffffu;
// odd, so that lanes which write or read a float of rows side by side use different banks
const uint kRowPitch = 17u;
shared float shared_rows[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x * kRowPitch : 1u];
shared uint shared_targets[COALESCED_ATOMICS != 0u ? gl_WorkGroupSize.x : 1u];

/// Whether all lanes of a subgroup must come to add_row() together; the same for the
/// whole workgroup. Not where a driver made subgroups that lack lanes: nobody would add
/// the floats of these.
bool rows_are_exchanged() {
    return COALESCED_ATOMICS != 0u && gl_NumSubgroups * gl_SubgroupSize == gl_WorkGroupSize.x;
}

uint own_shared_row() { return gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID; }

/// array[16 row + k] += amount, now or with add_row() of the same row.
void add_float(Floats array, uint row, uint k, float amount) {
    if (rows_are_exchanged()) shared_rows[own_shared_row() * kRowPitch + k] = amount;
    else atomic_add(array, 16u * row + k, amount);
}

/// Adds the rows of the subgroup's lanes where they are exchanged. Then all of its lanes
/// must come here together.
/// @param row     kNoRow: this lane has none
/// @param wanted  bit k: float k has been set; the same for all lanes
void add_row(Floats array, uint row, uint wanted) {
    if (!rows_are_exchanged()) return;
    shared_targets[own_shared_row()] = row;
    subgroupBarrier();
    // n lanes share n rows, float k is of lane k % n
    uint n = min(16u, gl_SubgroupSize), lane = gl_SubgroupInvocationID % n;
    uint first = own_shared_row() - lane;
    for (uint from = first; from < first + n; ++from) {
        uint to = shared_targets[from];
        if (to == kNoRow) continue;
        for (uint k = lane; k < 16u; k += n) {
            float amount = shared_rows[from * kRowPitch + k];
            if ((wanted & (1u << k)) != 0u && amount != 0.0) atomic_add(array, 16u * to + k, amount);
        }
    }
    subgroupBarrier();  // before the next rows come
}
#endif
