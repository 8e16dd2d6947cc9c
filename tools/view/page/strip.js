// SPDX-License-Identifier: Apache-2.0
// Draws a scan as an image. Each beam is one row, with the highest beam on top. The
// forward direction is in the middle.

export class Strip {
  /** @param onPoint (text) called with a description of the point under the mouse */
  constructor(canvas, onPoint) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d');
    canvas.addEventListener('pointermove', (event) => onPoint(this.pixelAt(event)));
    canvas.addEventListener('pointerleave', () => onPoint('\u00a0'));
  }

  /** @param rgba colours of the points @return true if the scan has an image */
  show(scan, rgba) {
    this.scan = scan;
    const hasImage = scan.rows > 1;
    if (!hasImage) {
      this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
      return false;
    }
    if (this.canvas.width !== scan.columns || this.canvas.height !== scan.rows)
      Object.assign(this.canvas, { width: scan.columns, height: scan.rows });
    this.context.putImageData(new ImageData(new Uint8ClampedArray(rgba), scan.columns, scan.rows), 0, 0);
    return true;
  }

  pixelAt(event) {
    if (!this.scan || this.scan.rows < 2) return '\u00a0';
    const box = this.canvas.getBoundingClientRect();
    const row = Math.min(this.scan.rows - 1, Math.floor(((event.clientY - box.top) / box.height) * this.scan.rows));
    const column = Math.min(this.scan.columns - 1, Math.floor(((event.clientX - box.left) / box.width) * this.scan.columns));
    if (row < 0 || column < 0) return '\u00a0';
    const i = row * this.scan.columns + column;
    const range = this.scan.range[i] > 0 ? `${this.scan.range[i].toFixed(2)} m` : 'no hit';
    return `row ${row}, column ${column}: ${range}, intensity ${(this.scan.intensity[i] / 255).toFixed(2)}, drop probability ${(this.scan.drop[i] / 255).toFixed(2)}`;
  }
}
