// SPDX-License-Identifier: Apache-2.0
// List of all primitives, one per line. C++ and GLSL generate code from this list: the
// enum PrimitiveType, the values of `image.primitive`, the metadata of model files and
// the kernel constant PRIMITIVE.
#ifndef RELIDAR_INCLUDED_SCENE_PRIMITIVES_H
#define RELIDAR_INCLUDED_SCENE_PRIMITIVES_H

/// PRIMITIVE(number in kernels, name in files and settings, plural name, third scale,
/// normals, proxy) describes one primitive.
///
///   third scale  true if it has a parameter log_scale_w, the standard deviation along
///                the third axis. Densification then also samples along this axis.
///   normals      true if the third axis is the normal of a surface
///   proxy        triangle mesh in a driver's acceleration structure: rectangle or
///                icosahedron
///
/// Kernels that branch on PRIMITIVE compute the intersection with a ray.
#define RELIDAR_PRIMITIVES(PRIMITIVE)                        \
    PRIMITIVE(0u, surfel, "surfels", false, true, rectangle) \
    PRIMITIVE(1u, gaussian, "3D Gaussians", true, false, icosahedron)

#endif
