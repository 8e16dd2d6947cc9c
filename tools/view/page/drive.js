// SPDX-License-Identifier: Apache-2.0
// Driving by keys: each moves the sensor at its speed while it is down. A key that is up again sooner than a hand can do it (a tap, a
// screen keyboard) counts for SHORTEST_MS, half a metre.

/** What the keys are for: ahead, left, up, turn. */
const DIRECTIONS = {
  w: [1, 0, 0, 0], s: [-1, 0, 0, 0], a: [0, 1, 0, 0], d: [0, -1, 0, 0], r: [0, 0, 1, 0], f: [0, 0, -1, 0], q: [0, 0, 0, 1], e: [0, 0, 0, -1],
};
const SPEEDS = [5, 5, 2.5, 45];   // m/s ahead, left, up; degrees/s
const FASTER = 4;                 // with Shift
const SHORTEST_MS = 100;

/** Keys that are down, and how far they have moved the sensor. Times are milliseconds of performance.now(). */
export class Held {
  constructor() {
    this.keys = new Map();   // {from, done, until}: down since, counted up to, up again at
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

  /** Shift is down from then on, or up. */
  shift(isFast, time) {
    if (isFast === this.isFast) return;
    this.count(time);
    this.isFast = isFast;
  }

  stop() { this.keys.clear(); }

  count(time) {
    for (const [key, held] of this.keys) {
      const until = Math.max(held.from, Math.min(time, held.until));   // before `done` where a picture came between a key and its event
      const seconds = ((until - held.done) * (this.isFast ? FASTER : 1)) / 1000;
      DIRECTIONS[key].forEach((way, i) => { this.moved[i] += way * SPEEDS[i] * seconds; });
      held.done = until;
      if (held.until <= time) this.keys.delete(key);
    }
  }

  /** @return [ahead, left, up, turn] metres and degrees since the last time */
  advance(time) {
    this.count(time);
    const { moved } = this;
    this.moved = [0, 0, 0, 0];
    return moved;
  }
}

/** @param onMove (ahead, left, up, turn) with each picture of the screen while keys are down @return what bindKeys() tells of keys */
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
  window.addEventListener('blur', stop);   // nobody tells when the key is up again
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
