// SPDX-License-Identifier: Apache-2.0
// Common header of all kernels of the library: the interface that kernels of programs
// use, too, and the specialisation constants.
#ifndef RELIDAR_INCLUDED_BASE_LIBRARY_KERNEL_GLSL
#define RELIDAR_INCLUDED_BASE_LIBRARY_KERNEL_GLSL
#include "shared/constants.h"
#include "relidar/base/kernel.glsl"
#define RELIDAR_CONSTANT_ID(name, id) const uint RELIDAR_ID_##name = id;
RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
/// Declares a specialisation constant by its name in shared/constants.h.
#define RELIDAR_CONSTANT(type, name, value) layout(constant_id = RELIDAR_ID_##name) const type name = value
#endif
