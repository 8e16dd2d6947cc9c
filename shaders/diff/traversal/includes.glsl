// SPDX-License-Identifier: Apache-2.0
// Includes all files that a tracing kernel needs, in the required order.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_INCLUDES_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_INCLUDES_GLSL
#extension GL_EXT_ray_query : enable
#include "../../base/kernel.glsl"
#include "../shared/trace.h"
#include "../../scene/gaussian/primitive.glsl"
#include "../../scene/gaussian/sh.glsl"
#include "traversal.glsl"
#include "shading.glsl"
#endif
