// SPDX-License-Identifier: Apache-2.0
// Which place on the ground a click means: the level plane through the point of the background that is drawn nearest to it says the height.

/**
 * @param x,y of the click, -1..1, up positive @param scan of frame.js @param shown (i) => whether point i is drawn
 * @param level height where no point is drawn @return [x, y] of the world, or null where the click looks into the sky
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
