// SPDX-License-Identifier: Apache-2.0
// Connects a number field of the page with a value. Each valid number is used while the
// user types.

const TYPING_PAUSE_MS = 1000;   // Longest pause between two characters of the same number.

/**
 * @param label name of the number in messages @param limit largest absolute value
 * @param get () => the number in use @param set (number) uses another number
 * @param say (text) shows an error
 */
export function bindNumberField(input, { label, limit, get, set, say }) {
  let before = get();         // Number in use before the user began to type.
  let rejected = -Infinity;   // Time of the last input that was out of range.
  const show = () => { input.value = String(Math.round(get() * 1000) / 1000); };
  input.addEventListener('focus', () => { before = get(); });
  input.addEventListener('change', () => {
    before = get();
    if (input.value === '') show();
  });
  input.addEventListener('input', ({ data, timeStamp }) => {
    if (input.value === '') return;   // Ignores "-" and "1e", which are incomplete numbers.
    const typed = Number(input.value);
    // The user may still be typing the number that was out of range.
    const isContinued = timeStamp - rejected < TYPING_PAUSE_MS && data !== input.value;
    if (Math.abs(typed) <= limit && !isContinued) {
      set(typed);
      return;
    }
    rejected = timeStamp;
    if (get() !== before) set(before);   // The first digits of the number were already in use.
    show();
    if (!isContinued) say(`${label}: ${typed} is out of range, expected -${limit} to ${limit}. The value stays at ${before}.`);
  });
}
