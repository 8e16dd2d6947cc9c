// SPDX-License-Identifier: Apache-2.0
// The panel with display settings and information about the scan.

const REAL = { light: [176, 56, 156], dark: [240, 160, 230] };
const RATE_WINDOW_MS = 3000;

export class Panel {
  /**
   * @param onMode called when another scan is needed @param onLook called when only the
   * display of the scan changes
   */
  constructor({ onMode, onLook }) {
    this.mode = 'simulated';
    this.wanted = null;   // Display mode that is selected when the log is loaded.
    this.hasLog = false;
    this.arrivals = [];
    this.onMode = onMode;
    this.message = document.getElementById('message');
    document.querySelectorAll('[data-mode]').forEach((b) => b.addEventListener('click', () => this.setMode(b.dataset.mode)));
    for (const id of ['colouring', 'show-grid', 'show-path', 'show-boxes', 'show-errors', 'show-dropped'])
      document.getElementById(id).addEventListener('change', onLook);
    document.getElementById('point-size').addEventListener('input', onLook);
    this.note = document.getElementById('note');
    document.getElementById('note-close').addEventListener('click', () => this.tell(''));
    this.markMode();
  }

  get colouring() { return document.getElementById('colouring').value; }

  /**
   * Sets the channels that can be shown as colours. @param channels [{name, unit,
   * meaning}]
   */
  setChannels(channels) {
    const list = document.getElementById('colouring');
    const chosen = list.value;
    list.querySelectorAll('[value^="channel:"]').forEach((o) => o.remove());
    for (const { name, unit, meaning } of channels)
      list.append(Object.assign(document.createElement('option'), { value: `channel:${name}`, textContent: unit ? `${name}, ${unit}` : name, title: meaning }));
    list.value = chosen;
    if (list.selectedIndex < 0) list.value = 'range';
  }

  get pointSize() { return Number(document.getElementById('point-size').value); }

  get shows() {
    return Object.fromEntries(['grid', 'path', 'boxes', 'errors', 'dropped'].map((name) => [name, document.getElementById(`show-${name}`).checked]));
  }

  /**
   * Sets the display as stored in a URL: {colour, size, layers}. Missing values do not
   * change.
   */
  get look() {
    const { shows } = this;
    return { colour: this.colouring, size: this.pointSize, layers: Object.keys(shows).filter((name) => shows[name]) };
  }

  set look({ colour, size, layers }) {
    const colouring = document.getElementById('colouring');
    if (colour && [...colouring.options].some((o) => o.value === colour)) colouring.value = colour;
    if (size) document.getElementById('point-size').value = String(size);
    if (layers) for (const name of Object.keys(this.shows)) document.getElementById(`show-${name}`).checked = layers.includes(name);
  }

  get realColour() { return matchMedia('(prefers-color-scheme: dark)').matches ? REAL.dark : REAL.light; }

  setMode(mode) {
    this.wanted = mode === 'simulated' || this.hasLog ? null : mode;
    if (this.wanted) return;
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

  setLog({ state, why }) {
    this.hasLog = state === 'ready';
    document.getElementById('log-state').textContent = this.hasLog ? '' : `Cannot show the real scans, because the log cannot be read: ${why}`;
    if (!this.hasLog) this.setMode('simulated');
    else if (this.wanted) this.setMode(this.wanted);
    else this.markMode();
  }

  waitForLog() {
    const wanted = this.wanted ?? this.mode;
    this.hasLog = false;
    document.getElementById('log-state').textContent = 'Reading the real scans from the log …';
    this.setMode('simulated');
    this.setMode(wanted);
  }

  /** Shows a message until the user closes it. say() shows temporary messages. */
  tell(text) {
    this.note.firstElementChild.textContent = text;
    this.note.hidden = !text;
  }

  say(text, isAlarm) {
    this.message.textContent = text;
    this.message.classList.toggle('alarm', isAlarm);
  }

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
