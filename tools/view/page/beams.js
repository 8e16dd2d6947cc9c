// SPDX-License-Identifier: Apache-2.0
// Lets the user select the beams that are shown. Each point has the number of its beam
// (ring). Ring 0 is the highest beam.

export class Beams {
  constructor(onChange) {
    this.onChange = onChange;
    this.shown = new Uint8Array(0);
    this.list = document.getElementById('beams');
    this.count = document.getElementById('n-beams');
    const set = (id, which) => document.getElementById(id).addEventListener('click', () => this.set(which));
    set('beams-all', () => 1);
    set('beams-none', () => 0);
    set('beams-second', (i) => (i % 2 === 0 ? 1 : 0));
    this.list.addEventListener('click', ({ target }) => {
      if (target.dataset.beam === undefined) return;
      const beam = Number(target.dataset.beam);
      this.shown[beam] ^= 1;
      this.tell();
    });
  }

  /**
   * Sets the rings of the displayed scan. If the number of beams changes, all beams are
   * selected.
   */
  fit(ring) {
    let n = 0;
    for (let i = 0; i < ring.length; ++i) if (ring[i] >= n) n = ring[i] + 1;
    if (n === this.shown.length) return;
    this.shown = new Uint8Array(n).fill(1);
    this.list.replaceChildren(...Array.from({ length: n }, (_, i) => {
      const button = Object.assign(document.createElement('button'), { type: 'button', textContent: String(i) });
      button.dataset.beam = String(i);
      button.setAttribute('aria-label', `beam ${i}`);
      return button;
    }));
    this.mark();
  }

  set(which) {
    this.shown = this.shown.map((_, i) => which(i));
    this.tell();
  }

  tell() {
    this.mark();
    this.onChange();
  }

  mark() {
    [...this.list.children].forEach((button, i) => button.setAttribute('aria-pressed', String(this.shown[i] === 1)));
    const n = this.shown.reduce((a, b) => a + b, 0);
    this.count.textContent = n === this.shown.length ? `${n}` : `${n} of ${this.shown.length}`;
  }

  /** Returns true if a ring is shown. An unknown ring is shown. */
  has(ring) { return this.shown[ring] !== 0; }
}
