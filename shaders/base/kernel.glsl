// SPDX-License-Identifier: Apache-2.0
// What every kernel starts with: its push constants, which are the address of its
// parameter struct and the address that stands for "no such array", and one thread an
// element.
#ifndef RELIDAR_INCLUDED_BASE_KERNEL_GLSL
#define RELIDAR_INCLUDED_BASE_KERNEL_GLSL
#include "shared/constants.h"
#include "relidar/base/lang.h"
#define RELIDAR_CONSTANT_ID(name, id) const uint RELIDAR_ID_##name = id;
RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
/// Declares a specialisation constant by its name in shared/constants.h.
#define RELIDAR_CONSTANT(type, name, value) layout(constant_id = RELIDAR_ID_##name) const type name = value
layout(local_size_x_id = RELIDAR_ID_WORKGROUP_SIZE) in;

/// Index of this thread. Launches of more workgroups than a device takes in one dimension
/// are folded into two (src/gpu/stream.cpp).
uint thread_index() {
    return gl_GlobalInvocationID.y * gl_NumWorkGroups.x * gl_WorkGroupSize.x + gl_GlobalInvocationID.x;
}

/// Number of threads of the launch, for loops over what only the device has counted.
uint thread_count() { return gl_NumWorkGroups.y * gl_NumWorkGroups.x * gl_WorkGroupSize.x; }

/// Index of this workgroup, folded in the same way.
uint workgroup_index() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }

layout(buffer_reference) buffer ParamsBlock;
// clang-format off
layout(push_constant, scalar) uniform Push {
    ParamsBlock block;
    uvec2 nothing;
} push;
// clang-format on

/// Whether the host passed no such array. The host then passes the address of a few zeros
/// instead of address 0, because some drivers execute loads of branches that no lane
/// takes (docs/debugging.md). So every pointer of the parameters can be read at its first
/// entries.
#define is_null(pointer) (uvec2(pointer) == push.nothing)

// Nobody writes the block, and the host tells the compiler so when it loads the module
// (src/gpu/spirv.hpp): then no store of the kernel can change a parameter, and it may
// stay in scalar registers. `readonly` here would not let a pointer be passed to a
// function, and a copy of the struct is one that SwiftShader's compiler does not survive.
#define RELIDAR_PARAMS(Type) \
    layout(buffer_reference, scalar, buffer_reference_align = 16) buffer ParamsBlock { Type value; }
#define params push.block.value
#endif
