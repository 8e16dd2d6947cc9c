// SPDX-License-Identifier: Apache-2.0
// 4x4 matrices in column-major order, as in WebGL, and vectors with three components. z
// is up.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const normalize = (a) => scale(a, 1 / (Math.hypot(...a) || 1));

/** Returns the product of two matrices, which applies b first, then a. */
export function multiply(a, b) {
  const m = new Float64Array(16);
  for (let column = 0; column < 4; ++column)
    for (let row = 0; row < 4; ++row)
      for (let k = 0; k < 4; ++k) m[4 * column + row] += a[4 * k + row] * b[4 * column + k];
  return m;
}

export const transform = (m, p) => [0, 1, 2].map((row) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row]);

/**
 * Returns the projection matrix of a camera that looks along -z.
 * @param angle vertical field of view in radians
 */
export function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
}

/**
 * Returns the matrix from world space to camera space. The direction must not be straight
 * up or down.
 */
export function look(eye, direction) {
  const right = normalize(cross(direction, [0, 0, 1]));
  const up = cross(right, direction);
  return [right[0], up[0], -direction[0], 0, right[1], up[1], -direction[1], 0, right[2], up[2], -direction[2], 0,
    -dot(right, eye), -dot(up, eye), dot(direction, eye), 1];
}

/** Returns the heading of a pose about z in radians. */
export const headingOf = (pose) => Math.atan2(pose[1], pose[0]);
