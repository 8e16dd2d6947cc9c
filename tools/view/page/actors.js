// SPDX-License-Identifier: Apache-2.0
// The traffic: hidden, moved, copied, removed, and saved as a run. What has been changed is one object, as tools/view/request.hpp has it.
import { instanceColour } from './colours.js';
import { headingOf, transform } from './matrix.js';

const MOVES = [['forward m', 0.5], ['left m', 0.5], ['up m', 0.25], ['turn °', 5]];
const COPY_BESIDE_M = 3.5;

const button = (label, onClick) => {
  const made = Object.assign(document.createElement('button'), { type: 'button', textContent: label });
  made.addEventListener('click', onClick);
  return made;
};

export class Actors {
  constructor(onChange, send) {
    this.onChange = onChange;
    this.copies = [];
    this.moves = {};
    this.removed = new Set();
    this.hidden = new Set();
    this.rows = new Map();
    this.known = [];
    this.list = document.getElementById('actors');
    this.name = document.getElementById('save-name');
    this.save = document.getElementById('save');
    this.hint = document.getElementById('save-hint');
    const mayWe = () => { this.save.disabled = !this.name.value || !this.name.checkValidity() || !this.isEdited; };
    this.checkSave = mayWe;
    this.name.addEventListener('input', mayWe);
    this.save.addEventListener('click', () => {
      this.say('saving …', false);
      send({ do: 'save', name: this.name.value, edits: this.edits });
    });
  }

  get edits() { return { copies: this.copies, moves: this.moves, removed: [...this.removed], hidden: [...this.hidden] }; }

  get isEdited() { return this.copies.length + this.removed.size + Object.keys(this.moves).length > 0; }

  say(text, isAlarm) {
    this.hint.textContent = text;
    this.hint.classList.toggle('alarm', isAlarm);
  }

  change() {
    this.say(this.isEdited ? 'The traffic is edited; saving leaves hidden actors in.' : '', false);
    this.checkSave();
    this.onChange();
  }

  /** Actors of the scan that is shown: [{track, category, size, present, pose}]. */
  update(actors, instances) {
    this.known = actors;
    document.getElementById('n-actors').textContent = `${actors.filter((a) => a.present).length} of ${actors.length} here`;
    if (actors.length === 0) this.list.textContent = 'This run has none.';
    if (actors.some((a) => !this.rows.has(a.track)) || actors.length !== this.rows.size) this.rebuild(actors, instances);
    for (const { track, present } of actors) {
      const row = this.rows.get(track);
      row.classList.toggle('absent', !present);
      row.classList.toggle('gone', this.removed.has(track));
    }
  }

  rebuild(actors, instances) {
    this.rows = new Map(actors.map((a) => [a.track, this.rows.get(a.track) ?? this.makeRow(a, instances.indexOf(a.track))]));
    this.list.replaceChildren(...this.rows.values());
  }

  makeRow({ track, category }, instance) {
    const row = Object.assign(document.createElement('details'), { className: 'actor' });
    row.dataset.track = track;
    const summary = document.createElement('summary');
    const swatch = document.createElement('i');
    swatch.style.background = `rgb(${instanceColour(instance).join(' ')})`;
    summary.append(swatch, `${track} · ${category}`);
    const buttons = Object.assign(document.createElement('div'), { className: 'row' });
    const hide = this.toggle('Hide', this.hidden, track);
    const remove = this.toggle('Remove', this.removed, track);
    buttons.append(hide, button('Copy', () => this.copy(track)), remove);
    row.append(summary, buttons, this.makeMoves(track));
    return row;
  }

  /** A button that puts a track into a set, or takes it out. */
  toggle(label, set, track) {
    const made = button(label, () => {
      if (!set.delete(track)) set.add(track);
      made.setAttribute('aria-pressed', String(set.has(track)));
      this.change();
    });
    made.setAttribute('aria-pressed', String(set.has(track)));
    return made;
  }

  makeMoves(track) {
    const fields = document.createElement('fieldset');
    fields.append(Object.assign(document.createElement('legend'), { textContent: 'moved, as it faces' }));
    const inputs = MOVES.map(([label, step]) => {
      const input = Object.assign(document.createElement('input'), { type: 'number', step, value: 0 });
      input.addEventListener('input', () => {
        const by = inputs.map((i) => Number(i.value) || 0);
        if (by.every((v) => v === 0)) delete this.moves[track];
        else this.moves[track] = by;
        this.change();
      });
      const field = document.createElement('label');
      field.append(label, input);
      fields.append(field);
      return input;
    });
    return fields;
  }

  /** Once more, parked beside where it is now. */
  copy(track) {
    const { pose } = this.known.find((a) => a.track === track);
    const [x, y, z] = transform(pose, [0, COPY_BESIDE_M, 0]);
    this.copies.push({ of: track, at: [x, y, z, (headingOf(pose) * 180) / Math.PI, 0] });
    this.change();
  }

  /** Boxes of those that are there. */
  get boxes() {
    return this.known.map((actor, i) => ({ ...actor, instance: i + 1 })).filter((a) => a.present && !this.removed.has(a.track) && !this.hidden.has(a.track));
  }
}
