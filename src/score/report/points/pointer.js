// SPDX-License-Identifier: Apache-2.0
// Mouse control of a view. Dragging rotates the camera. Dragging with the right or middle
// button, or with Ctrl, moves the camera sideways. The wheel zooms.

const LONGEST_CLICK = 4;   // maximum movement in pixels that still counts as a click

/**
 * @param onChange called after each change of the camera
 * @param onGround (from, to) called for dragging with Shift, with points on the plane at
 * planeHeight(); or null
 * @param onClick ([x, y]) called for a click without dragging; -1..1, up positive
 */
export function steer(view, camera, { onChange, onGround = null, planeHeight = () => 0, onClick = () => {} }) {
  const { canvas } = view;
  const pixel = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
  };
  const place = (event) => camera.onPlane(...pixel(event), view.aspect, planeHeight());
  let ground = null;
  let dragged = 0;   // pixels since the button was pressed
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    ground = onGround && event.shiftKey ? place(event) : null;
    dragged = 0;
  });
  canvas.addEventListener('pointerup', (event) => {
    if (canvas.hasPointerCapture(event.pointerId) && event.button === 0 && dragged < LONGEST_CLICK) onClick(pixel(event));
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    dragged += Math.hypot(event.movementX, event.movementY);
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
