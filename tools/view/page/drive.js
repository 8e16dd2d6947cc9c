// SPDX-License-Identifier: Apache-2.0
// Moves the sensor with keys. While a key is pressed, the sensor moves at a constant
// speed. Very short key presses, for example of a screen keyboard, count as SHORTEST_MS,
// so that the sensor moves by at least half a metre.

/** Direction of each key: ahead, left, up, turn. */
const DIRECTIONS = {
  w: [1, 0, 0, 0], s: [-1, 0, 0, 0], a: [0, 1, 0, 0], d: [0, -1, 0, 0], r: [0, 0, 1, 0], f: [0, 0, -1, 0], q: [0, 0, 0, 1], e: [0, 0, 0, -1],
};
const SPEEDS = [5, 5, 2.5, 45];   // m/s ahead, left and up; degrees/s to turn.
const FASTER = 4;                 // Factor while Shift is pressed.
const SHORTEST_MS = 100;

/**
 * Pressed keys and the distance that they have moved the sensor. Times are milliseconds
 * of performance.now().
 */
export class Held {
  constructor() {
    // {from, done, until} for each key: the times when the key was pressed, when its
    // motion was last applied, and when the key was released.
    this.keys = new Map();
    this.isFast = false;
    this.moved = [0, 0, 0, 0];
  }

  press(key, time) {
    if (this.keys.get(key)?.until !== Infinity) this.keys.set(key, { from: time, done: time, until: Infinity });
  }

  release(key, time) {
    const held = this.keys.get(key);
    if (held) held.until = Math.max(time, held.from + SHORTEST_MS);
  }

  shift(isFast, time) {
    if (isFast === this.isFast) return;
    this.count(time);
    this.isFast = isFast;
  }

  stop() { this.keys.clear(); }

  count(time) {
    for (const [key, held] of this.keys) {
      // The time can be before `done` if a picture was drawn between the key press and
      // its event.
      const until = Math.max(held.from, Math.min(time, held.until));
      const seconds = ((until - held.done) * (this.isFast ? FASTER : 1)) / 1000;
      DIRECTIONS[key].forEach((way, i) => { this.moved[i] += way * SPEEDS[i] * seconds; });
      held.done = until;
      if (held.until <= time) this.keys.delete(key);
    }
  }

  /** @return [ahead, left, up, turn] in metres and degrees since the previous call */
  advance(time) {
    this.count(time);
    const { moved } = this;
    this.moved = [0, 0, 0, 0];
    return moved;
  }
}

/**
 * @param onMove (ahead, left, up, turn) called for each displayed picture while keys are
 * pressed @return the driver that bindKeys() notifies of keys
 */
export function makeDriver(onMove) {
  const held = new Held();
  let isTicking = false;
  const tick = () => {
    const moved = held.advance(performance.now());
    if (moved.some((v) => v !== 0)) onMove(...moved);
    isTicking = held.keys.size > 0;
    if (isTicking) requestAnimationFrame(tick);
  };
  const stop = () => held.stop();
  // If the page has no focus, it is not notified when a key is released. Therefore all
  // keys count as released.
  window.addEventListener('blur', stop);
  document.addEventListener('visibilitychange', stop);
  return {
    keys: Object.keys(DIRECTIONS),
    stop,
    shift(event) { held.shift(event.shiftKey, event.timeStamp); },
    press(key, event) {
      if (!event.repeat) held.press(key, event.timeStamp);
      if (!isTicking) requestAnimationFrame(tick);
      isTicking = true;
    },
    release(key, event) { held.release(key, event.timeStamp); },
  };
}
