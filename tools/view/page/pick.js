// SPDX-License-Identifier: Apache-2.0
// Converts a mouse click into a position on the ground. The height of the position is
// that of the visible background point nearest to the click.

/**
 * @param x,y position of the click, -1..1, up positive
 * @param scan scan as returned by frame.js
 * @param shown (i) => true if point i is drawn
 * @param level height that is used if no point is drawn
 * @return [x, y] in the world frame, or null if the click is above the horizon
 */
export function pickGround(camera, aspect, [x, y], scan, shown, level) {
  const m = camera.matrix(aspect);
  let nearest = Infinity;
  let height = level;
  for (let i = 0; scan && i < scan.range.length; ++i) {
    if (!shown(i) || (scan.instance && scan.instance[i] !== 0)) continue;
    const [px, py, pz] = scan.position.subarray(3 * i, 3 * i + 3);
    const w = m[3] * px + m[7] * py + m[11] * pz + m[15];
    if (w <= 0) continue;
    const dx = ((m[0] * px + m[4] * py + m[8] * pz + m[12]) / w - x) * aspect;
    const dy = (m[1] * px + m[5] * py + m[9] * pz + m[13]) / w - y;
    const distance = dx * dx + dy * dy;
    if (distance < nearest) [nearest, height] = [distance, pz];
  }
  const place = camera.onPlane(x, y, aspect, height);
  return place && [place[0], place[1]];
}
