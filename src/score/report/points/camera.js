// SPDX-License-Identifier: Apache-2.0
// A camera for scenes whose z axis points up. The camera orbits a point, flies freely, or
// follows a moving object.
import { add, look, multiply, normalize, cross, perspective, scale } from './matrix.js';

const ANGLE = (50 * Math.PI) / 180;
const STEEPEST = 1.55;   // maximum pitch, radians; at pi/2, left and right would be undefined

export class Camera {
  constructor() {
    this.mode = 'follow';
    this.target = [0, 0, 0];
    this.yaw = 0;          // radians; in mode "follow", relative to the heading of the object
    this.pitch = -0.42;
    this.distance = 26;
    this.heading = 0;
  }

  get direction() {
    const yaw = this.yaw + (this.mode === 'follow' ? this.heading : 0);
    const level = Math.cos(this.pitch);
    return [Math.cos(yaw) * level, Math.sin(yaw) * level, Math.sin(this.pitch)];
  }

  get eye() {
    return this.mode === 'fly' ? this.target : add(this.target, scale(this.direction, -this.distance));
  }

  /** Changes the mode and keeps the view. */
  setMode(mode) {
    const { eye, direction } = this;
    if (this.mode === 'follow') this.yaw += this.heading;
    this.mode = mode;
    if (mode === 'fly') this.target = eye;
    else if (mode === 'orbit') this.target = add(eye, scale(direction, this.distance));
    else this.yaw = 0;
  }

  /** Restores a saved state: {mode, yaw, pitch, distance, target}. */
  restore({ mode, yaw, pitch, distance, target }) {
    Object.assign(this, { mode, yaw, distance: Math.max(1, Math.min(400, distance)), target });
    this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, pitch));
  }

  /** Sets the pose of the object that the camera follows. */
  track(position, heading) {
    if (this.mode !== 'follow') return;
    this.target = position;
    this.heading = heading;
  }

  turn(dx, dy) {
    this.yaw -= dx * 0.005;
    this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch - dy * 0.005));
  }

  /**
   * Moves the camera parallel to the image plane.
   * @param dx,dy pixels
   * @param height height of the view in pixels
   */
  pan(dx, dy, height) {
    const right = normalize(cross(this.direction, [0, 0, 1]));
    const metres = (2 * this.distance * Math.tan(ANGLE / 2)) / height;
    if (this.mode === 'follow') this.setMode('orbit');
    this.target = add(this.target, add(scale(right, -dx * metres), scale(cross(right, this.direction), dy * metres)));
  }

  /** Zooms in (factor below 1) or out. In mode "fly", moves forward or back. */
  zoom(factor) {
    if (this.mode === 'fly') this.target = add(this.target, scale(this.direction, -10 * Math.log(factor)));
    else this.distance = Math.max(1, Math.min(400, this.distance * factor));
  }

  /** Moves the camera by metres: forward, left and up. Ends mode "follow". */
  move(ahead, left, up) {
    if (this.mode === 'follow') this.setMode('orbit');
    const level = normalize([this.direction[0], this.direction[1], 0]);
    const sideways = cross([0, 0, 1], level);
    this.target = add(add(this.target, scale(level, ahead)), add(scale(sideways, left), [0, 0, up]));
  }

  /** Returns the matrix from world space to clip space. */
  matrix(aspect) {
    return multiply(perspective(ANGLE, aspect, 0.2, 1500), look(this.eye, this.direction));
  }

  /**
   * Returns where the ray through an image point hits the horizontal plane at a height.
   * Returns null if the ray does not hit the plane.
   * @param x,y -1..1, up positive
   */
  onPlane(x, y, aspect, height) {
    const { direction, eye } = this;
    const right = normalize(cross(direction, [0, 0, 1]));
    const up = cross(right, direction);
    const t = Math.tan(ANGLE / 2);
    const ray = add(direction, add(scale(right, x * t * aspect), scale(up, y * t)));
    const along = (height - eye[2]) / ray[2];
    return along > 0 && along < 1000 ? add(eye, scale(ray, along)) : null;
  }
}
