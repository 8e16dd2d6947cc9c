// SPDX-License-Identifier: Apache-2.0
// WebSocket connection to the program. Only one scan at a time is requested. If the state
// of the page changes before the scan arrives, a scan of the newest state is requested
// next. If the connection is lost, the page connects again after pauses of increasing
// length.
import { decodeFrame } from './frame.js';

const FIRST_PAUSE_S = 0.5;
const LONGEST_PAUSE_S = 8;

export class Link {
  /**
   * @param state () => the state to scan, without "do" and "id"
   * @param on callbacks {text(message), frame(frame, asked), lost(pause_s, isLocked)};
   * asked: the state of the scan; isLocked: true if the program requires a token
   */
  constructor(state, on) {
    this.state = state;
    this.on = on;
    this.id = 0;
    this.pause = FIRST_PAUSE_S;
    this.connect();
    document.addEventListener('visibilitychange', () => { if (!document.hidden && this.timer) this.connect(); });
  }

  connect() {
    clearTimeout(this.timer);
    this.timer = null;
    this.waiting = false;   // True while a requested scan is pending.
    this.stale = false;  // True if the state of the page has changed since the last scan was requested.
    this.asked = null;
    this.socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/live`);
    this.socket.binaryType = 'arraybuffer';
    this.socket.onmessage = ({ data }) => (typeof data === 'string' ? this.heard(JSON.parse(data)) : this.received(data));
    this.socket.onclose = () => this.lost();
  }

  lost() {
    const pause = this.pause;
    this.pause = Math.min(LONGEST_PAUSE_S, 2 * pause);
    this.waiting = false;
    this.timer = setTimeout(() => this.connect(), 1000 * pause);
    this.on.lost(pause, false);
    fetch('/', { cache: 'no-store' }).then(({ status }) => { if (status === 401 && this.timer) this.on.lost(pause, true); }, () => {});
  }

  get isOpen() { return this.socket.readyState === WebSocket.OPEN; }

  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
    return this.isOpen;
  }

  refresh() {
    this.stale = true;
    if (!this.waiting) this.ask();
  }

  ask() {
    if (!this.isOpen) return;
    this.stale = false;
    this.waiting = true;
    this.asked = this.state();
    this.send({ do: 'scan', id: ++this.id, ...this.asked });
  }

  heard(message) {
    this.pause = FIRST_PAUSE_S;
    const isAboutScan = message.kind === 'error' && (message.about === 'scan' || message.about === 'message');
    if (isAboutScan) this.waiting = false;   // The requested scan will not arrive.
    this.on.text(message);
    if (isAboutScan && this.stale && !this.waiting) this.ask();
  }

  received(data) {
    const { asked } = this;
    this.waiting = false;
    // Requests the next scan before this scan is drawn, so that the program renders while
    // the page draws.
    if (this.stale) this.ask();
    this.on.frame(decodeFrame(data), asked);
  }
}
