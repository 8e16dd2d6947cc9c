// SPDX-License-Identifier: Apache-2.0
// Real spherical harmonics (SH) up to degree 3, and their gradient with respect to the
// direction. Order and signs are the same as in 3D Gaussian Splatting. A channel has the
// value 0.5 + basis(direction) . coefficients.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_SH_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_SH_GLSL

const float kSh0 = 0.28209479177387814;
const float kSh1 = 0.4886025119029199;
const float kSh2[5] = float[](1.0925484305920792, -1.0925484305920792, 0.31539156525252005,
                              -1.0925484305920792, 0.5462742152960396);
const float kSh3[7] = float[](-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
                              -0.4570457994644658, 1.445305721320277, -0.5900435899266435);

uint count_sh(uint degree) { return (degree + 1u) * (degree + 1u); }

/// Computes the SH basis functions for a unit direction. Functions above the given degree
/// are set to 0.
void sh_basis(vec3 direction, uint degree, out float basis[16]) {
    for (int k = 0; k < 16; ++k) basis[k] = 0.0;
    basis[0] = kSh0;
    if (degree < 1u) return;
    float x = direction.x, y = direction.y, z = direction.z;
    basis[1] = -kSh1 * y;
    basis[2] = kSh1 * z;
    basis[3] = -kSh1 * x;
    if (degree < 2u) return;
    float xx = x * x, yy = y * y, zz = z * z;
    basis[4] = kSh2[0] * x * y;
    basis[5] = kSh2[1] * y * z;
    basis[6] = kSh2[2] * (2.0 * zz - xx - yy);
    basis[7] = kSh2[3] * x * z;
    basis[8] = kSh2[4] * (xx - yy);
    if (degree < 3u) return;
    basis[9] = kSh3[0] * y * (3.0 * xx - yy);
    basis[10] = kSh3[1] * x * y * z;
    basis[11] = kSh3[2] * y * (4.0 * zz - xx - yy);
    basis[12] = kSh3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
    basis[13] = kSh3[4] * x * (4.0 * zz - xx - yy);
    basis[14] = kSh3[5] * z * (xx - yy);
    basis[15] = kSh3[6] * x * (xx - 3.0 * yy);
}

/// Returns dL/d(direction) from dL/d(basis). Treats the direction as an independent
/// vector. The caller must apply the derivative of its normalisation.
vec3 sh_basis_vjp(vec3 direction, uint degree, float d_basis[16]) {
    vec3 g = vec3(0.0);
    if (degree < 1u) return g;
    float x = direction.x, y = direction.y, z = direction.z;
    g += vec3(-kSh1 * d_basis[3], -kSh1 * d_basis[1], kSh1 * d_basis[2]);
    if (degree < 2u) return g;
    g += d_basis[4] * kSh2[0] * vec3(y, x, 0.0);
    g += d_basis[5] * kSh2[1] * vec3(0.0, z, y);
    g += d_basis[6] * kSh2[2] * vec3(-2.0 * x, -2.0 * y, 4.0 * z);
    g += d_basis[7] * kSh2[3] * vec3(z, 0.0, x);
    g += d_basis[8] * kSh2[4] * vec3(2.0 * x, -2.0 * y, 0.0);
    if (degree < 3u) return g;
    float xx = x * x, yy = y * y, zz = z * z;
    g += d_basis[9] * kSh3[0] * vec3(6.0 * x * y, 3.0 * xx - 3.0 * yy, 0.0);
    g += d_basis[10] * kSh3[1] * vec3(y * z, x * z, x * y);
    g += d_basis[11] * kSh3[2] * vec3(-2.0 * x * y, 4.0 * zz - xx - 3.0 * yy, 8.0 * y * z);
    g += d_basis[12] * kSh3[3] * vec3(-6.0 * x * z, -6.0 * y * z, 6.0 * zz - 3.0 * xx - 3.0 * yy);
    g += d_basis[13] * kSh3[4] * vec3(4.0 * zz - 3.0 * xx - yy, -2.0 * x * y, 8.0 * x * z);
    g += d_basis[14] * kSh3[5] * vec3(2.0 * x * z, -2.0 * y * z, xx - yy);
    g += d_basis[15] * kSh3[6] * vec3(3.0 * xx - 3.0 * yy, -6.0 * x * y, 0.0);
    return g;
}
#endif
