// SPDX-License-Identifier: Apache-2.0
// The WebSocket to the program: one scan is asked for at a time, and of what changes meanwhile only the last state is asked for next.
import { decodeFrame } from './frame.js';

export class Link {
  /** @param on {text(message), frame(frame), lost()} @param state () => what is to be scanned, without "do" and "id" */
  constructor(state, on) {
    this.state = state;
    this.on = on;
    this.id = 0;
    this.waiting = false;   // for a scan
    this.stale = false;     // the state has changed since it was asked for
    this.socket = new WebSocket(`${location.protocol === 'https:' ? 'wss' : 'ws'}://${location.host}/live`);
    this.socket.binaryType = 'arraybuffer';
    this.socket.onmessage = ({ data }) => (typeof data === 'string' ? this.heard(JSON.parse(data)) : this.received(data));
    this.socket.onclose = () => on.lost();
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** The state has changed. */
  refresh() {
    this.stale = true;
    if (!this.waiting) this.ask();
  }

  ask() {
    if (this.socket.readyState !== WebSocket.OPEN) return;
    this.stale = false;
    this.waiting = true;
    this.send({ do: 'scan', id: ++this.id, ...this.state() });
  }

  heard(message) {
    this.on.text(message);
    if (message.kind !== 'error' || (message.about !== 'scan' && message.about !== 'message')) return;
    this.waiting = false;   // the scan will not come
    if (this.stale) this.ask();
  }

  received(data) {
    this.waiting = false;
    if (this.stale) this.ask();   // before drawing: the next is rendered meanwhile
    this.on.frame(decodeFrame(data));
  }
}
