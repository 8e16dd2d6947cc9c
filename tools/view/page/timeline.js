// SPDX-License-Identifier: Apache-2.0
// Timeline of the log. The user can play the log, drag the position, or step from frame
// to frame.

export class Timeline {
  /** @param onChange (time_s) */
  constructor(onChange) {
    this.onChange = onChange;
    this.frames = [];
    this.time = 0;
    this.playing = false;
    this.slider = document.getElementById('time');
    this.text = document.getElementById('time-text');
    this.button = document.getElementById('play');
    this.slider.addEventListener('input', () => this.set(this.first + Number(this.slider.value)));
    this.button.addEventListener('click', () => this.toggle());
    document.getElementById('back').addEventListener('click', () => this.step(-1));
    document.getElementById('forth').addEventListener('click', () => this.step(1));
  }

  /**
   * Sets the frames of the log in order: [{time_s, index, held_out}]. @param time start
   * time; default: the middle of the log
   */
  load(frames, time) {
    this.frames = frames;
    this.first = frames[0].time_s;
    this.last = frames[frames.length - 1].time_s;
    this.slider.max = String(this.last - this.first);
    this.set(time ?? frames[Math.floor(frames.length / 2)].time_s);
  }

  get nearest() {
    return this.frames.reduce((a, b) => (Math.abs(b.time_s - this.time) < Math.abs(a.time_s - this.time) ? b : a));
  }

  set(time) {
    this.time = Math.max(this.first, Math.min(this.last, time));
    this.slider.value = String(this.time - this.first);
    const { index, time_s: frameTime, held_out: heldOut } = this.nearest;
    const beside = this.time - frameTime;
    const place = Math.abs(beside) < 1e-6 ? '' : ` ${beside > 0 ? '+' : '−'} ${Math.abs(beside).toFixed(3)} s`;
    this.text.textContent = `${(this.time - this.first).toFixed(2)} s · frame ${index}${place}${heldOut && !place ? ' (held out of training)' : ''}`;
    this.slider.setAttribute('aria-valuetext', this.text.textContent);
    this.onChange();
  }

  step(by) {
    this.pause();
    const here = this.frames.indexOf(this.nearest);
    this.set(this.frames[Math.max(0, Math.min(this.frames.length - 1, here + by))].time_s);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  pause() {
    this.playing = false;
    this.show();
  }

  play() {
    this.playing = true;
    this.show();
    if (this.time >= this.last) this.set(this.first);
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      const passed = ((now - before) / 1000) * Number(document.getElementById('speed').value);
      before = now;
      this.set(this.time + passed);
      if (this.time >= this.last) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  show() {
    this.button.setAttribute('aria-pressed', String(this.playing));
    this.button.setAttribute('aria-label', this.playing ? 'Pause' : 'Play');
  }
}
