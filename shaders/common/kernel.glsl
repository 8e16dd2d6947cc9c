// SPDX-License-Identifier: Apache-2.0
// What every kernel starts with: one 8-byte push constant, the address of its parameter struct, and one thread an element.
#ifndef RELIDAR_INCLUDED_COMMON_KERNEL_GLSL
#define RELIDAR_INCLUDED_COMMON_KERNEL_GLSL
layout(local_size_x_id = 0) in;

#define RELIDAR_PARAMS(Type)                                                                                   \
    layout(buffer_reference, scalar, buffer_reference_align = 8) buffer ParamsBlock { Type value; };  \
    layout(push_constant, scalar) uniform Push { ParamsBlock block; } push
#define params push.block.value
#endif
