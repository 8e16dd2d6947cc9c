// SPDX-License-Identifier: Apache-2.0
// Whose a key is: the page's, or that of the list, field or button that has the focus.

const OWN_KEYS = { range: ['arrowup', 'arrowdown', 'arrowleft', 'arrowright'], button: [' '], checkbox: [' '], file: [' '] };

/** Whether what has the focus needs a key itself. */
function needs(target, key) {
  if (target.closest('textarea, select, dialog')) return true;
  if (target.closest('button, summary')) return OWN_KEYS.button.includes(key);
  const input = target.closest('input');
  return input !== null && (OWN_KEYS[input.type]?.includes(key) ?? true);   // text and numbers: all of them
}

/** Calls what a key is bound to, unless it is another's. @param bindings {key: (event) => void} @param driver of drive.js; keys in lower case */
export function bindKeys(bindings, driver) {
  document.addEventListener('keydown', (event) => {
    const key = event.key.toLowerCase();
    driver.shift(event);
    if (event.ctrlKey || event.metaKey || event.altKey) return driver.stop();   // a key of the browser's, whose end may never come
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
 * Gives the keyboard back to the view after a choice in a list, so that the next key drives. Who goes through a list by its own keys
 * keeps it, until Enter or Escape; these end typing a number, too.
 */
export function giveBackFocus(view) {
  let isBrowsing = false;   // by keys
  const isOne = (target) => target.matches?.('select, input[type="number"]');
  document.addEventListener('pointerdown', () => { isBrowsing = false; }, true);
  document.addEventListener('keydown', ({ target, key }) => {
    if (!isOne(target)) return;
    isBrowsing = key !== 'Enter' && key !== 'Escape';
    if (!isBrowsing) setTimeout(() => view.focus());   // after the list has closed and told of its choice
  }, true);
  document.addEventListener('focusin', ({ target }) => { if (isOne(target)) isBrowsing = false; });
  document.addEventListener('change', ({ target }) => { if (target.matches('select') && !isBrowsing) view.focus(); });
}
