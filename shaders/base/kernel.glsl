// SPDX-License-Identifier: Apache-2.0
// Common header of all kernels of the library: the interface that kernels of programs
// use, too, the specialisation constants, and optional features. A kernel that does not
// use a feature also runs on devices without it.
#ifndef RELIDAR_INCLUDED_BASE_LIBRARY_KERNEL_GLSL
#define RELIDAR_INCLUDED_BASE_LIBRARY_KERNEL_GLSL
#extension GL_EXT_shader_atomic_float : enable
#extension GL_KHR_shader_subgroup_arithmetic : enable
#extension GL_KHR_shader_subgroup_ballot : enable
#extension GL_KHR_shader_subgroup_basic : enable
#extension GL_KHR_shader_subgroup_shuffle : enable
#extension GL_KHR_shader_subgroup_vote : enable
#include "shared/constants.h"
#include "relidar/base/kernel.glsl"
#define RELIDAR_CONSTANT_ID(name, id) const uint RELIDAR_ID_##name = id;
RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
/// Declares a specialisation constant by its name in shared/constants.h.
#define RELIDAR_CONSTANT(type, name, value) layout(constant_id = RELIDAR_ID_##name) const type name = value
#endif
