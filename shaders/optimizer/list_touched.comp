// SPDX-License-Identifier: Apache-2.0
// Numbers of the rows that have a gradient, side by side, so that every lane of the steps over them has one: lanes of a CPU that have
// nothing to do cost as much as the others. One thread a row. The order differs from run to run, and no result depends on it.
// Input: touched. Output: rows, count (zero before).
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_ballot : require
#include "../common/kernel.glsl"
#include "../shared/optimizer.h"
RELIDAR_PARAMS(ListTouchedParams);

void main() {
    uint row = thread_index();
    bool touched = row < params.n_rows && params.touched.at[row] != 0u;
    uvec4 all = subgroupBallot(touched);
    uint first = 0u;
    if (subgroupElect()) first = atomicAdd(params.count.at[0], subgroupBallotBitCount(all));
    first = subgroupBroadcastFirst(first);
    if (touched) params.rows.at[first + subgroupBallotExclusiveBitCount(all)] = row;
}
