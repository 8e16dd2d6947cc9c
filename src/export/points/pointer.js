// SPDX-License-Identifier: Apache-2.0
// The mouse over a view: drag turns the camera, right or middle button or Ctrl pans, the wheel zooms.

/**
 * @param onChange after each change of the camera
 * @param onGround (from, to) while Shift is held: places that were dragged over the plane whose height planeHeight() gives; or null
 */
export function steer(view, camera, { onChange, onGround = null, planeHeight = () => 0 }) {
  const { canvas } = view;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    const x = (2 * (event.clientX - box.left)) / box.width - 1;
    const y = 1 - (2 * (event.clientY - box.top)) / box.height;
    return camera.onPlane(x, y, view.aspect, planeHeight());
  };
  let ground = null;
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    ground = onGround && event.shiftKey ? place(event) : null;
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    if (ground) {
      const now = place(event);
      if (now) onGround(ground, now);
      ground = now ?? ground;
      return;
    }
    const isPan = event.ctrlKey || event.buttons & 6;
    if (isPan) camera.pan(event.movementX, event.movementY, canvas.clientHeight);
    else camera.turn(event.movementX, event.movementY);
    onChange();
  });
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY * 0.0015))));
    onChange();
  }, { passive: false });
}
