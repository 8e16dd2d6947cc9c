// SPDX-License-Identifier: Apache-2.0
// Common header of all compute kernels. Declares the push constants: the address of the
// parameter struct, and an address that marks a missing array.
#ifndef RELIDAR_INCLUDED_BASE_KERNEL_GLSL
#define RELIDAR_INCLUDED_BASE_KERNEL_GLSL
#include "shared/constants.h"
#include "relidar/base/lang.h"
#define RELIDAR_CONSTANT_ID(name, id) const uint RELIDAR_ID_##name = id;
RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
/// Declares a specialisation constant by its name in shared/constants.h.
#define RELIDAR_CONSTANT(type, name, value) layout(constant_id = RELIDAR_ID_##name) const type name = value
layout(local_size_x_id = RELIDAR_ID_WORKGROUP_SIZE) in;

/// Returns the global index of this thread. The launch has two dimensions if the number
/// of workgroups exceeds the device's limit for one dimension.
uint thread_index() {
    return gl_GlobalInvocationID.y * gl_NumWorkGroups.x * gl_WorkGroupSize.x + gl_GlobalInvocationID.x;
}

/// Returns the number of threads of the launch. Loops use it if only the device knows the
/// number of elements.
uint thread_count() { return gl_NumWorkGroups.y * gl_NumWorkGroups.x * gl_WorkGroupSize.x; }

/// Returns the index of this workgroup, counted over both dimensions of the launch.
uint workgroup_index() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }

layout(buffer_reference) buffer ParamsBlock;
// clang-format off
layout(push_constant, scalar) uniform Push {
    ParamsBlock block;
    uvec2 nothing;
} push;
// clang-format on

/// Returns true if the host passed no array. The host then passes the address of a few
/// zeros instead of address 0, because some drivers execute loads in branches that no
/// lane takes (docs/debugging.md). Therefore the first entries of every pointer in the
/// parameters can be read.
#define is_null(pointer) (uvec2(pointer) == push.nothing)

// No kernel writes the parameter block, and the host marks it read-only when it loads the
// module (src/gpu/spirv.hpp). The compiler then knows that no store changes a parameter,
// and can keep parameters in scalar registers. With `readonly` here, pointers could not
// be passed to functions, and a copy of the struct crashes SwiftShader's compiler.
#define RELIDAR_PARAMS(Type) \
    layout(buffer_reference, scalar, buffer_reference_align = 16) buffer ParamsBlock { Type value; }
#define params push.block.value
#endif
