// SPDX-License-Identifier: Apache-2.0
// Which primitive a kernel is built for, and what its row in relidar/scene/primitives.h
// says of it.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_KINDS_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_KINDS_GLSL
#include "relidar/scene/primitives.h"
RELIDAR_CONSTANT(uint, PRIMITIVE, 0u);

// kPrimitive_surfel, ...
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) \
    const uint kPrimitive_##name = number;
RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)
#undef RELIDAR_PRIMITIVE

const uint kProxy_rectangle = 2u, kProxy_icosahedron = 20u;  // triangles of each

bool has_third_scale() {
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
