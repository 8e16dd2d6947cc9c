// SPDX-License-Identifier: Apache-2.0
// Decides who handles a key press: the page, or the list, field or button that has the
// focus.

const OWN_KEYS = { range: ['arrowup', 'arrowdown', 'arrowleft', 'arrowright'], button: [' '], checkbox: [' '], file: [' '] };

function needs(target, key) {
  if (target.closest('textarea, select, dialog')) return true;
  if (target.closest('button, summary')) return OWN_KEYS.button.includes(key);
  const input = target.closest('input');
  // Fields for text and numbers use all keys.
  return input !== null && (OWN_KEYS[input.type]?.includes(key) ?? true);
}

/**
 * Calls the function that is bound to a key, unless the focused element uses the key.
 * @param bindings {key: (event) => void} @param driver of drive.js; keys in lower case
 */
export function bindKeys(bindings, driver) {
  document.addEventListener('keydown', (event) => {
    const key = event.key.toLowerCase();
    driver.shift(event);
    // Ignores browser shortcuts, because the release of their keys may not be reported.
    if (event.ctrlKey || event.metaKey || event.altKey) return driver.stop();
    if (needs(event.target, key)) return undefined;
    if (driver.keys.includes(key)) {
      event.preventDefault();
      return driver.press(key, event);
    }
    if (!bindings[key]) return undefined;
    event.preventDefault();
    return bindings[key](event);
  });
  document.addEventListener('keyup', (event) => {
    driver.shift(event);
    driver.release(event.key.toLowerCase(), event);
  });
}

/**
 * Returns the keyboard focus to the view after a choice in a list, so that the next key
 * drives. The list keeps the focus while the user navigates it with keys, until Enter or
 * Escape. These keys also end the input of a number.
 */
export function giveBackFocus(view) {
  let isBrowsing = false;   // True while the user navigates a list with keys.
  const isOne = (target) => target.matches?.('select, input[type="number"]');
  document.addEventListener('pointerdown', () => { isBrowsing = false; }, true);
  document.addEventListener('keydown', ({ target, key }) => {
    if (!isOne(target)) return;
    isBrowsing = key !== 'Enter' && key !== 'Escape';
    // Waits until the list is closed and its choice was applied.
    if (!isBrowsing) setTimeout(() => view.focus());
  }, true);
  document.addEventListener('focusin', ({ target }) => { if (isOne(target)) isBrowsing = false; });
  document.addEventListener('change', ({ target }) => { if (target.matches('select') && !isBrowsing) view.focus(); });
}
