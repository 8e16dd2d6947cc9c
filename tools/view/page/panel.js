// SPDX-License-Identifier: Apache-2.0
// How the scan is shown, and what is said of it.

const REAL = { light: [176, 56, 156], dark: [240, 160, 230] };
const RATE_WINDOW_MS = 3000;

export class Panel {
  /** @param onMode another scan is wanted @param onLook the same scan looks otherwise */
  constructor({ onMode, onLook }) {
    this.mode = 'simulated';
    this.hasLog = false;
    this.arrivals = [];
    this.onMode = onMode;
    this.message = document.getElementById('message');
    document.querySelectorAll('[data-mode]').forEach((b) => b.addEventListener('click', () => this.setMode(b.dataset.mode)));
    for (const id of ['colouring', 'show-grid', 'show-path', 'show-boxes', 'show-errors', 'show-dropped'])
      document.getElementById(id).addEventListener('change', onLook);
    document.getElementById('point-size').addEventListener('input', onLook);
    this.markMode();
  }

  get colouring() { return document.getElementById('colouring').value; }

  get pointSize() { return Number(document.getElementById('point-size').value); }

  get shows() {
    return Object.fromEntries(['grid', 'path', 'boxes', 'errors', 'dropped'].map((name) => [name, document.getElementById(`show-${name}`).checked]));
  }

  get realColour() { return matchMedia('(prefers-color-scheme: dark)').matches ? REAL.dark : REAL.light; }

  setMode(mode) {
    if (mode !== 'simulated' && !this.hasLog) return;
    this.mode = mode;
    this.markMode();
    this.onMode();
  }

  markMode() {
    document.querySelectorAll('[data-mode]').forEach((b) => {
      b.setAttribute('aria-pressed', String(b.dataset.mode === this.mode));
      b.disabled = b.dataset.mode !== 'simulated' && !this.hasLog;
    });
  }

  markCamera(mode) {
    document.querySelectorAll('[data-camera]').forEach((b) => b.setAttribute('aria-pressed', String(b.dataset.camera === mode)));
  }

  /** The log's own scans are there, or will not be. */
  setLog({ state, why }) {
    this.hasLog = state === 'ready';
    document.getElementById('log-state').textContent = this.hasLog ? '' : `The log's own scans cannot be shown: ${why}`;
    this.markMode();
  }

  say(text, isAlarm) {
    this.message.textContent = text;
    this.message.classList.toggle('alarm', isAlarm);
  }

  /** Numbers of a scan that has come. */
  setNumbers({ header, simulated, real }) {
    this.say('', false);
    const scan = simulated ?? real;
    const put = (id, text) => { document.getElementById(id).textContent = text; };
    let n = 0;
    if (scan) for (let i = 0; i < scan.range.length; ++i) n += scan.drop[i] < 128 && scan.range[i] > 0 ? 1 : 0;
    put('n-points', n.toLocaleString('en'));
    put('image-size', !scan ? '–' : scan.rows > 1 ? `${scan.rows} × ${scan.columns}` : `${scan.range.length} rays`);
    put('unseen', header.unseen === undefined ? '–' : `${(100 * header.unseen).toFixed(1)} %`);
    document.getElementById('unseen').classList.toggle('alarm', header.much_unseen === true);
    put('scan-ms', header.total_ms.toFixed(0));
    this.arrivals.push(performance.now());
    while (this.arrivals[0] < performance.now() - RATE_WINDOW_MS) this.arrivals.shift();
    put('rate', this.arrivals.length < 3 ? '–' : (((this.arrivals.length - 1) * 1000) / (this.arrivals[this.arrivals.length - 1] - this.arrivals[0])).toFixed(1));
    this.setKernels(header.kernels ?? []);
  }

  setKernels(kernels) {
    document.getElementById('kernels').replaceChildren(...[...kernels].sort((a, b) => b[1] - a[1]).map(([name, ms]) => {
      const row = document.createElement('tr');
      row.append(...[name, ms.toFixed(2)].map((text) => Object.assign(document.createElement('td'), { textContent: text })));
      return row;
    }));
  }
}
