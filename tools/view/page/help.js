// SPDX-License-Identifier: Apache-2.0
// Shows the help page for keys and mouse.

const KEYS = [
  [['W', 'A', 'S', 'D'], 'move the sensor forward, left, backward, right at 5 m/s, with Shift at 20 m/s'],
  [['R', 'F'], 'move the sensor up, down at 2.5 m/s, with Shift at 10 m/s'],
  [['Q', 'E'], 'turn the sensor left, right at 45 degrees/s, with Shift at 180 degrees/s'],
  [['0'], 'move the sensor back to its position in the log'],
  [['Space'], 'play, pause'],
  [[',', '.'], 'previous frame, next frame'],
  [['1', '2', '3'], 'show the simulated scan, the real scan, both'],
  [['C'], 'change the camera mode: follow, orbit, fly'],
  [['←', '→', '↑', '↓'], 'move the camera'],
  [['drag'], 'rotate the camera; with the right button or Ctrl: move the camera; wheel: zoom'],
  [['Shift', 'drag'], 'move the sensor over the ground'],
  [['Enter'], 'leave a list or a number field, so that the keys move the sensor again'],
  [['Esc'], 'cancel the placement of an actor'],
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
