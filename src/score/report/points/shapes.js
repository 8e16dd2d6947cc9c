// SPDX-License-Identifier: Apache-2.0
// Creates lines that are drawn in a scene: a grid on the ground, axes, boxes, a path.
// Each function returns {position, rgba} for CloudView.setLines().
import { transform } from './matrix.js';

/** A list of coloured lines. */
class Lines {
  constructor() {
    this.ends = [];
    this.colours = [];
  }

  add(a, b, colour) {
    this.ends.push(...a, ...b);
    this.colours.push(...colour, ...colour);
    return this;
  }

  get arrays() { return { position: new Float32Array(this.ends), rgba: new Uint8Array(this.colours) }; }
}

/**
 * Returns a horizontal grid of 10 m around a point. The lines are short, because some
 * drivers drop lines that start behind the camera.
 */
export function grid([x, y, z], reach, colour) {
  const lines = new Lines();
  const [left, bottom] = [Math.round(x / 10) * 10, Math.round(y / 10) * 10];
  for (let across = -reach; across <= reach; across += 10) {
    for (let along = -reach; along < reach; along += 10) {
      lines.add([left + across, bottom + along, z], [left + across, bottom + along + 10, z], colour);
      lines.add([left + along, bottom + across, z], [left + along + 10, bottom + across, z], colour);
    }
  }
  return lines.arrays;
}

/** Returns the axes of a pose: x red, y green, z blue. */
export function axes(pose, length) {
  const lines = new Lines();
  const origin = transform(pose, [0, 0, 0]);
  lines.add(origin, transform(pose, [length, 0, 0]), [214, 48, 60, 255]);
  lines.add(origin, transform(pose, [0, length, 0]), [40, 160, 80, 255]);
  lines.add(origin, transform(pose, [0, 0, length]), [50, 110, 235, 255]);
  return lines.arrays;
}

/**
 * Returns the edges of boxes, and a forward line from the centre of each roof.
 * @param all [{pose, size, colour}]
 */
export function boxes(all) {
  const lines = new Lines();
  for (const { pose, size, colour } of all) {
    const [l, w, h] = size.map((s) => s / 2);
    const corner = (k) => transform(pose, [k & 1 ? l : -l, k & 2 ? w : -w, k & 4 ? h : -h]);
    for (let k = 0; k < 8; ++k) for (const bit of [1, 2, 4]) if (!(k & bit)) lines.add(corner(k), corner(k | bit), colour);
    lines.add(transform(pose, [0, 0, h]), transform(pose, [l + 1, 0, h]), colour);
  }
  return lines.arrays;
}

/** Returns a line through points. */
export function path(places, colour) {
  const lines = new Lines();
  for (let i = 1; i < places.length; ++i) lines.add(places[i - 1], places[i], colour);
  return lines.arrays;
}

/**
 * Returns a line for each pair of points.
 * @param from,to Float32Array, three values for each point
 * @param which indices of the pairs
 */
export function pairs(from, to, which, colour) {
  const position = new Float32Array(6 * which.length);
  const rgba = new Uint8Array(8 * which.length);
  which.forEach((i, k) => {
    position.set(from.subarray(3 * i, 3 * i + 3), 6 * k);
    position.set(to.subarray(3 * i, 3 * i + 3), 6 * k + 3);
    rgba.set([...colour, ...colour], 8 * k);
  });
  return { position, rgba };
}
