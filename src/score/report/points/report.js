// SPDX-License-Identifier: Apache-2.0
// Draws the 3D views of the report: point clouds side by side, with a common camera.
// src/score/report/report_parts.cpp packs the points.
import { Camera } from './camera.js';
import { CloudView } from './cloud_view.js';
import { COLOURINGS, coloursOf, cssGradient } from './colours.js';
import { steer } from './pointer.js';
import { axes, grid } from './shapes.js';

const BYTES = 8;
const ERROR_STEP_M = 0.004;
const SENSOR_HEIGHT_M = 1.8;
const MAX_RANGE_M = 80;
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const darkPage = matchMedia('(prefers-color-scheme: dark)');

/** Unpacks a scan for coloursOf(), and the range errors of its points. */
function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const n = bytes.length / BYTES;
  const scan = { position: new Float32Array(3 * n), range: new Float32Array(n), intensity: new Uint8Array(n), drop: new Uint8Array(n) };
  const error = new Float32Array(n);
  for (let i = 0; i < n; ++i) {
    const place = [0, 2, 4].map((offset) => view.getInt16(BYTES * i + offset, true) / 100);
    scan.position.set(place, 3 * i);
    scan.range[i] = Math.hypot(...place);
    scan.intensity[i] = bytes[BYTES * i + 6];
    error[i] = bytes[BYTES * i + 7] === 255 ? NaN : bytes[BYTES * i + 7] * ERROR_STEP_M;
  }
  return { scan, error };
}

function setUp(box) {
  const camera = new Camera();
  const choice = box.querySelector('select');
  const clouds = [...box.querySelectorAll('canvas')].map((canvas) => ({ view: new CloudView(canvas), ...unpack(canvas.dataset.points) }));
  const draw = () => clouds.forEach(({ view }) => {
    view.background = darkPage.matches ? [0.043, 0.055, 0.071] : [0.969, 0.973, 0.98];
    view.draw(camera);
  });
  let planned = false;
  const redraw = () => {
    if (!planned) requestAnimationFrame(() => { planned = false; draw(); });
    planned = true;
  };
  const colour = () => {
    const gray = darkPage.matches ? [46, 53, 62, 255] : [214, 219, 226, 255];
    for (const { view, scan, error } of clouds) {
      view.setPoints('points', scan.position, coloursOf(scan, choice.value, { maxRange: MAX_RANGE_M, sensorHeight: 0, error, shown: () => true }));
      const ground = grid([0, 0, -SENSOR_HEIGHT_M], MAX_RANGE_M, gray);
      view.setLines('grid', ground.position, ground.rgba);
      const cross = axes(IDENTITY, 2);
      view.setLines('axes', cross.position, cross.rgba);
    }
    const { label, unit, ends, map } = COLOURINGS[choice.value];
    const [low, high] = ends({ maxRange: MAX_RANGE_M });
    const bar = Object.assign(document.createElement('i'), { title: label });
    bar.style.background = cssGradient(map);
    box.querySelector('.legend3d').replaceChildren(String(low), bar, `${high} ${unit}`);
    redraw();
  };
  const keys = { ArrowLeft: [20, 0], ArrowRight: [-20, 0], ArrowUp: [0, 20], ArrowDown: [0, -20] };
  for (const { view } of clouds) {
    steer(view, camera, { onChange: redraw });
    view.canvas.addEventListener('keydown', (event) => {
      const factor = { '+': 0.85, '-': 1.18 }[event.key];
      if (keys[event.key]) camera.turn(...keys[event.key]);
      else if (factor) camera.zoom(factor);
      else return;
      event.preventDefault();
      redraw();
    });
    new ResizeObserver(redraw).observe(view.canvas);
  }
  choice.addEventListener('change', colour);
  darkPage.addEventListener('change', colour);
  colour();
}

document.querySelectorAll('.view3d').forEach((box) => {
  try {
    setUp(box);
  } catch (error) {
    box.querySelector('.note').textContent = `The view in 3D cannot be shown: ${error.message}.`;
  }
});
