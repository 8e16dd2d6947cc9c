// SPDX-License-Identifier: Apache-2.0
// Rotation matrix of a quaternion (w, x, y, z), and its derivative. The quaternion may
// have any length, so its gradient is perpendicular to the quaternion.
#ifndef RELIDAR_INCLUDED_SCENE_GAUSSIAN_QUATERNION_GLSL
#define RELIDAR_INCLUDED_SCENE_GAUSSIAN_QUATERNION_GLSL

/// Returns the rotation matrix of `quaternion` / |quaternion|. Its columns are the
/// surfel's axes a_u and a_v, and its normal.
mat3 rotation_matrix(vec4 quaternion) {
    quaternion = normalize(quaternion);
    float w = quaternion.x, x = quaternion.y, y = quaternion.z, z = quaternion.w;
    return mat3(vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
                vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
                vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)));
}

/// Returns dL/dq from dL/dR. Column j of `d_matrix` is the gradient of column j of the
/// rotation matrix R.
vec4 rotation_vjp(vec4 quaternion, mat3 d_matrix) {
    float inverse_length = inversesqrt(dot(quaternion, quaternion));
    vec4 unit = quaternion * inverse_length;
    float w = unit.x, x = unit.y, y = unit.z, z = unit.w;
    vec3 du = d_matrix[0], dv = d_matrix[1], dn = d_matrix[2];
    vec4 d_unit;
    d_unit.x = 2.0 * (z * (du.y - dv.x) + y * (dn.x - du.z) + x * (dv.z - dn.y));
    d_unit.y = 2.0 * (y * (du.y + dv.x) + z * (du.z + dn.x) + w * (dv.z - dn.y)) - 4.0 * x * (dv.y + dn.z);
    d_unit.z = 2.0 * (x * (du.y + dv.x) + z * (dv.z + dn.y) + w * (dn.x - du.z)) - 4.0 * y * (du.x + dn.z);
    d_unit.w = 2.0 * (x * (du.z + dn.x) + y * (dv.z + dn.y) + w * (du.y - dv.x)) - 4.0 * z * (du.x + dv.y);
    return (d_unit - unit * dot(unit, d_unit)) * inverse_length;
}
#endif
