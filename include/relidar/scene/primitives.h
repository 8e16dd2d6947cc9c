// SPDX-License-Identifier: Apache-2.0
// Every kind of primitive, a line each: the only list of them, read by C++ and GLSL. From
// it come Primitive and kPrimitives (relidar/scene/scene.hpp), the choices of
// `image.primitive`, the mark of models and checkpoints, and the constant PRIMITIVE of
// kernels.
#ifndef RELIDAR_INCLUDED_SCENE_PRIMITIVES_H
#define RELIDAR_INCLUDED_SCENE_PRIMITIVES_H

/// PRIMITIVE(number in kernels, name in files and settings, what several are called, a
/// third scale, normals, proxy)
///   a third scale  a parameter log_scale_w: the standard deviation along the third axis, along which densification draws and moves too
///   normals        the third axis is that of a surface
///   proxy          what its triangles are in a driver's tree: rectangle, icosahedron
/// What a ray meets is said where kernels branch by PRIMITIVE.
#define RELIDAR_PRIMITIVES(PRIMITIVE)                        \
    PRIMITIVE(0u, surfel, "surfels", false, true, rectangle) \
    PRIMITIVE(1u, gaussian, "3D Gaussians", true, false, icosahedron)

#endif
