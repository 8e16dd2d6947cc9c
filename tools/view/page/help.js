// SPDX-License-Identifier: Apache-2.0
// Keys: what they do, and the page that says so.

const KEYS = [
  [['W', 'A', 'S', 'D'], 'drive the sensor ahead, left, back, right (Shift: in steps of 5 m)'],
  [['R', 'F'], 'sensor up, down'],
  [['Q', 'E'], 'turn the sensor left, right'],
  [['0'], 'sensor back to the place of the log'],
  [['Space'], 'play, pause'],
  [[',', '.'], 'frame before, next frame'],
  [['1', '2', '3'], 'simulated, real, both'],
  [['C'], 'next camera: follow, orbit, fly'],
  [['←', '→', '↑', '↓'], 'move the camera'],
  [['drag'], 'turn the camera; right button or Ctrl: move it; wheel: nearer, farther'],
  [['Shift', 'drag'], 'move the sensor over the ground'],
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

/** Calls what a key is bound to, unless the person types. @param bindings {key: (event) => void}, keys in lower case */
export function bindKeys(bindings) {
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest('input, select, textarea, dialog')) return;
    if (event.key === ' ' && event.target.closest('button, summary')) return;
    const action = bindings[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
}
