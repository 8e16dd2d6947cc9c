// SPDX-License-Identifier: Apache-2.0
// Edits the actors of the scene. Actors can be hidden, moved, copied, placed on the
// ground and removed. The result can be saved as a run. All edits are stored in one
// object, which tools/view/request.hpp describes.
import { instanceColour } from './colours.js';
import { headingOf, transform } from './matrix.js';
import { bindNumberField } from './number_field.js';

// Label, step and limit of each field.
const MOVES = [['forward m', 0.5, 10000], ['left m', 0.5, 10000], ['up m', 0.25, 10000], ['turn left °', 5, 360]];
const COPY_BESIDE_M = 3.5;

const button = (label, onClick) => {
  const made = Object.assign(document.createElement('button'), { type: 'button', textContent: label });
  made.addEventListener('click', onClick);
  return made;
};

const without = ({ hidden, ...saved }) => JSON.stringify(saved);   // Edits that saving keeps.
const NOTHING = { copies: [], moves: {}, removed: [], hidden: [] };

export class Actors {
  /**
   * @param onPlacing called with {of, from} when the user starts to choose a position for
   * an actor, and with null when the choice ends
   */
  constructor(onChange, onPlacing, send) {
    this.onChange = onChange;
    this.onPlacing = onPlacing;
    this.rows = new Map();
    this.known = [];
    this.own = new Set();     // Tracks of the run itself.
    this.placing = null;
    this.accepted = NOTHING;  // Edits of the most recent scan.
    this.savedAs = without(NOTHING);
    this.put(NOTHING);
    this.list = document.getElementById('actors');
    this.name = document.getElementById('save-name');
    this.save = document.getElementById('save');
    this.hint = document.getElementById('save-hint');
    this.insert = document.getElementById('insert');
    this.name.addEventListener('input', () => this.checkSave());
    this.save.addEventListener('click', () => {
      this.saving = without(this.edits);
      if (send({ do: 'save', name: this.name.value, edits: this.edits })) this.say('saving …', false);
      else this.say('The server cannot be reached. Nothing was saved.', true);
    });
    const place = document.getElementById('insert-place');
    place.addEventListener('click', () => this.place(this.placing ? null : JSON.parse(this.insert.value)));
  }

  checkSave() { this.save.disabled = !this.name.value || !this.name.checkValidity() || !this.isEdited; }

  load({ actors, others }) {
    this.own = new Set(actors.map(({ track }) => track));
    this.insert.replaceChildren(...others.flatMap(({ name, actors: theirs }) => theirs.map(
      ({ track, category }) => new Option(`${name}#${track} · ${category}`, JSON.stringify({ of: track, from: name })))));
    document.getElementById('insert-row').hidden = this.insert.length === 0;
  }

  put({ copies, moves, removed, hidden }) {
    this.copies = copies.map((copy) => ({ ...copy }));
    this.moves = { ...moves };
    this.removed = new Set(removed);
    this.hidden = new Set(hidden);
    this.rows.clear();
  }

  /**
   * Replaces the edits by those of a URL, or by none. @param isSaved true if a run was
   * saved with them
   */
  restore(edits, isSaved) {
    this.put(edits ?? NOTHING);
    if (isSaved) this.savedAs = without(this.edits);
    this.change();
  }

  accept(edits) { this.accepted = edits; }

  /** Undoes the edits that no scan has confirmed. @return true if any edit was undone */
  takeBack() {
    if (JSON.stringify(this.edits) === JSON.stringify(this.accepted)) return false;
    this.restore(this.accepted, false);
    return true;
  }

  saved(folder) {
    this.savedAs = this.saving;
    this.say(`saved as ${folder}`, false);
    this.hint.scrollIntoView({ block: 'nearest' });   // The hint may be below the visible part of the panel.
    this.onChange();
  }

  get isUnsaved() { return this.isEdited && without(this.edits) !== this.savedAs; }

  get edits() { return { copies: this.copies, moves: this.moves, removed: [...this.removed], hidden: [...this.hidden] }; }

  get isEdited() { return this.copies.length + this.removed.size + Object.keys(this.moves).length > 0; }

  say(text, isAlarm) {
    this.hint.textContent = text;
    this.hint.classList.toggle('alarm', isAlarm);
    if (isAlarm) this.hint.scrollIntoView({ block: 'nearest' });
  }

  change() {
    this.say(this.isEdited ? 'The actors are edited. Saving also stores hidden actors.' : '', false);
    this.checkSave();
    this.onChange();
  }

  update(actors, instances) {
    this.known = actors;
    document.getElementById('n-actors').textContent = `${actors.filter((a) => a.present).length} of ${actors.length} present`;
    if (actors.length === 0) this.list.textContent = 'This run has no actors.';
    if (actors.some((a) => !this.rows.has(a.track)) || actors.length !== this.rows.size) this.rebuild(actors, instances);
    for (const { track, present } of actors) {
      const row = this.rows.get(track);
      row.classList.toggle('absent', !present);
      row.classList.toggle('gone', this.removed.has(track));
    }
  }

  rebuild(actors, instances) {
    this.rows = new Map(actors.map((a) => [a.track, this.rows.get(a.track) ?? this.makeRow(a, Math.max(0, instances.indexOf(a.track)))]));
    this.list.replaceChildren(...this.rows.values());
  }

  makeRow({ track, category, standing }, instance) {
    const row = Object.assign(document.createElement('details'), { className: 'actor' });
    row.dataset.track = track;
    const summary = document.createElement('summary');
    const swatch = document.createElement('i');
    swatch.style.background = `rgb(${instanceColour(instance).join(' ')})`;
    summary.append(swatch, `${track} · ${category}${standing ? ' · parked' : ''}`);
    const buttons = Object.assign(document.createElement('div'), { className: 'row' });
    const place = button('Place …', () => this.place(this.placing?.of === track ? null : { of: track, from: '' }));
    place.title = 'Place a copy of this actor on the ground where you click next';
    place.hidden = !this.own.has(track);
    const hide = this.toggle('Hide', 'hidden', track);
    const remove = this.toggle('Remove', 'removed', track);
    buttons.append(hide, button('Copy', () => this.copy(track)), remove, place);
    row.append(summary, buttons, this.makeMoves(track));
    return row;
  }

  toggle(label, set, track) {
    const mark = () => made.setAttribute('aria-pressed', String(this[set].has(track)));
    const made = button(label, () => {
      if (!this[set].delete(track)) this[set].add(track);
      mark();
      this.change();
    });
    mark();
    return made;
  }

  makeMoves(track) {
    const fields = document.createElement('fieldset');
    fields.append(Object.assign(document.createElement('legend'), { textContent: 'shift relative to its heading' }));
    MOVES.forEach(([label, step, limit], i) => {
      const get = () => this.moves[track]?.[i] ?? 0;
      const input = Object.assign(document.createElement('input'), { type: 'number', step, value: get() });
      const set = (number) => {
        const by = [...(this.moves[track] ?? MOVES.map(() => 0))];
        by[i] = number;
        if (by.every((v) => v === 0)) delete this.moves[track];
        else this.moves[track] = by;
        this.change();
      };
      bindNumberField(input, { label, limit, get, set, say: (text) => this.say(text, true) });
      const labelled = document.createElement('label');
      labelled.append(label, input);
      fields.append(labelled);
    });
    return fields;
  }

  copy(track) {
    const { pose } = this.known.find((a) => a.track === track);
    const [x, y, z] = transform(pose, [0, COPY_BESIDE_M, 0]);
    this.add({ of: track, from: '', at: [x, y, z, (headingOf(pose) * 180) / Math.PI, 0, 0, 0] });
  }

  place(actor) {
    this.placing = actor;
    this.say(actor ? `Click on the ground to place ${actor.of}. Press Esc to cancel.` : '', false);
    this.onPlacing(actor);
  }

  placed({ of, from, at }) {
    this.place(null);
    this.add({ of, from, at });
  }

  add({ of, from, at }) {
    // Rounded to millimetres to keep the URL short.
    this.copies.push({ of, from, at: at.map((v) => Math.round(v * 1000) / 1000) });
    this.change();
  }

  get boxes() {
    return this.known.map((actor, i) => ({ ...actor, instance: actor.standing ? 0 : i + 1 })).filter((a) => a.present && !this.removed.has(a.track) && !this.hidden.has(a.track));
  }
}
