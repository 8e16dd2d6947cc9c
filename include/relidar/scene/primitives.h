// SPDX-License-Identifier: Apache-2.0
// List of all primitives, one line each, read by C++ and GLSL. It defines Primitive and
// kPrimitives (relidar/scene/scene.hpp), the values of `image.primitive`, the metadata of
// models and checkpoints, and the constant PRIMITIVE of kernels.
#ifndef RELIDAR_INCLUDED_SCENE_PRIMITIVES_H
#define RELIDAR_INCLUDED_SCENE_PRIMITIVES_H

/// PRIMITIVE(number in kernels, name in files and settings, plural name, third scale,
/// normals, proxy)
///
///   third scale  has a parameter log_scale_w, the standard deviation along the third axis;
///                densification also samples and moves along this axis
///   normals      the third axis is the normal of a surface
///   proxy        triangle mesh in a driver's acceleration structure: rectangle or icosahedron
///
/// Kernels that branch on PRIMITIVE define the intersection with a ray.
#define RELIDAR_PRIMITIVES(PRIMITIVE)                        \
    PRIMITIVE(0u, surfel, "surfels", false, true, rectangle) \
    PRIMITIVE(1u, gaussian, "3D Gaussians", true, false, icosahedron)

#endif
