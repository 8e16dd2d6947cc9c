// SPDX-License-Identifier: Apache-2.0
// Interface between the host and a compute kernel: the workgroup size, the index of a
// thread, and two push constants. They are the address of the parameter struct, and the
// address that replaces missing arrays. Programs include this file in their own kernels
// (Kernel::from_spirv in relidar/gpu/kernel.hpp).
#ifndef RELIDAR_INCLUDED_BASE_KERNEL_GLSL
#define RELIDAR_INCLUDED_BASE_KERNEL_GLSL
#include "relidar/base/lang.h"
layout(local_size_x_id = 0) in;  // The host sets this constant, a power of two.

/// Returns the global index of this thread. The launch has two dimensions, because Vulkan
/// limits the number of workgroups per dimension.
uint thread_index() {
    return gl_GlobalInvocationID.y * gl_NumWorkGroups.x * gl_WorkGroupSize.x + gl_GlobalInvocationID.x;
}

uint thread_count() { return gl_NumWorkGroups.y * gl_NumWorkGroups.x * gl_WorkGroupSize.x; }

uint workgroup_index() { return gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x; }

layout(buffer_reference) buffer ParamsBlock;
// clang-format off
layout(push_constant, scalar) uniform Push {
    ParamsBlock block;
    uvec2 nothing;
} push;
// clang-format on

/// Returns true if the host passed no array for this pointer. The host then passes
/// `push.nothing`, the address of a small array of zeros. It does not pass a null
/// address, because some drivers load from the pointer even in branches that no thread
/// executes.
#define is_null(pointer) (uvec2(pointer) == push.nothing)

// The host marks this block as read-only in the SPIR-V code (src/gpu/spirv.hpp), so that
// compilers can keep the parameters in scalar registers. The GLSL qualifier `readonly` is
// not used, because pointers in the block could then not be passed to functions. Copying
// the struct to a local variable would crash the compiler of SwiftShader.
#define RELIDAR_PARAMS(Type) \
    layout(buffer_reference, scalar, buffer_reference_align = 16) buffer ParamsBlock { Type value; }
#define params push.block.value
#endif
