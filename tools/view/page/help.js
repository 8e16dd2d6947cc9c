// SPDX-License-Identifier: Apache-2.0
// Shows the help page for keys and mouse.

const KEYS = [
  [['W', 'A', 'S', 'D'], 'drive the sensor ahead, left, back, right while the key is down: 5 m/s, with Shift 20 m/s'],
  [['R', 'F'], 'sensor up, down: 2.5 m/s, with Shift 10 m/s'],
  [['Q', 'E'], 'turn the sensor left, right: 45 degrees/s, with Shift 180'],
  [['0'], 'sensor back to the place of the log'],
  [['Space'], 'play, pause'],
  [[',', '.'], 'frame before, next frame'],
  [['1', '2', '3'], 'simulated, real, both'],
  [['C'], 'next camera: follow, orbit, fly'],
  [['←', '→', '↑', '↓'], 'move the camera'],
  [['drag'], 'turn the camera; right button or Ctrl: move it; wheel: nearer, farther'],
  [['Shift', 'drag'], 'move the sensor over the ground'],
  [['Enter'], 'in a list or a number: the keys drive again'],
  [['Esc'], 'place nothing after all'],
  [['?'], 'this help'],
];

export function setUpHelp() {
  const dialog = document.getElementById('help');
  const list = document.getElementById('help-keys');
  for (const [keys, text] of KEYS) {
    const left = document.createElement('div');
    keys.forEach((key, i) => left.append(i ? ' ' : '', Object.assign(document.createElement('kbd'), { textContent: key })));
    list.append(left, Object.assign(document.createElement('div'), { textContent: text }));
  }
  const open = () => { if (!dialog.open) dialog.showModal(); };
  document.getElementById('help-button').addEventListener('click', open);
  return open;
}
