// SPDX-License-Identifier: Apache-2.0
// Selects the type of primitive (surfel or 3D Gaussian) for which a kernel is compiled.
// The table in relidar/scene/primitives.h lists the properties of each type.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_KINDS_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_KINDS_GLSL
#include "relidar/scene/primitives.h"
RELIDAR_CONSTANT(uint, PRIMITIVE, 0u);

// Defines a constant for each primitive: kPrimitive_surfel, ...
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) \
    const uint kPrimitive_##name = number;
RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)
#undef RELIDAR_PRIMITIVE

const uint kProxy_rectangle = 2u, kProxy_icosahedron = 20u;  // number of triangles of each proxy

bool has_third_axis() {
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) \
    if (PRIMITIVE == number) return third_scale;
    RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)
#undef RELIDAR_PRIMITIVE
    return false;
}

uint proxy_triangles() {
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) \
    if (PRIMITIVE == number) return kProxy_##proxy;
    RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)
#undef RELIDAR_PRIMITIVE
    return 0u;
}
#endif
