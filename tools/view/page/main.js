// SPDX-License-Identifier: Apache-2.0
// Connects the parts of the page and reacts to their changes. This file draws the scans
// that link.js requests.
import { Actors } from './actors.js';
import { readAddress, writeAddress } from './address.js';
import { Beams } from './beams.js';
import { Camera } from './camera.js';
import { CloudView } from './cloud_view.js';
import { colouringOf, coloursOf, cssGradient, flatColours, instanceColour } from './colours.js';
import { makeDriver } from './drive.js';
import { returned } from './frame.js';
import { setUpHelp } from './help.js';
import { bindKeys, giveBackFocus } from './keys.js';
import { Link } from './link.js';
import { headingOf } from './matrix.js';
import { Panel } from './panel.js';
import { pickGround } from './pick.js';
import { steer } from './pointer.js';
import { SensorPanel } from './sensor.js';
import * as shapes from './shapes.js';
import { Strip } from './strip.js';
import { Timeline } from './timeline.js';

// Assumed height of the log's sensor above the ground in metres, on the roof of a car.
// The grid is drawn at the height of the ground.
const SENSOR_HEIGHT_M = 1.8;
const SHORTEST_ERROR_M = 0.1;     // Minimum length of an error line.
const GRID_REACH_M = 80;
// Size of real points relative to simulated points. Real points are smaller, so that
// simulated points stay visible.
const REAL_SIZE = 0.6;
// Minimum time between two changes of the URL. Browsers reject more than a few changes
// per second.
const ADDRESS_PAUSE_MS = 500;
const NOWHERE = [0, 0, 0, 0, 0, 0];
const DARK = matchMedia('(prefers-color-scheme: dark)');
const element = (id) => document.getElementById(id);

let hello = null;
// True while several values are being changed. The scan is requested only after the last
// change.
let isSettling = false;
let frame = null;                 // The most recent scan.
let drawn = false;                // True if the picture shows the current state.
const camera = new Camera();
const view = makeView();
const panel = new Panel({ onMode: refresh, onLook: show });
const timeline = new Timeline(refresh);
const actors = new Actors(refresh, (actor) => element('view').classList.toggle('placing', actor !== null), send);
const sensor = new SensorPanel(refresh, send);
const beams = new Beams(show);
const tellPixel = (text) => { element('pixel').textContent = text; };
const strip = new Strip(element('strip'), tellPixel);
const realStrip = new Strip(element('real-strip'), tellPixel);
const link = new Link(state, { text: heard, frame: received, lost });

function makeView() {
  try {
    return new CloudView(element('view'));
  } catch (error) {
    element('message').textContent = error.message;
    throw error;
  }
}

function state() {
  return { time_s: timeline.time, ...sensor.wish, simulate: panel.mode !== 'real', real: panel.mode !== 'simulated', edits: actors.edits };
}

function send(message) { return link.send(message); }

function refresh() {
  if (!hello || isSettling) return;
  link.refresh();
  remember();
}

function heard(message) {
  if (message.kind === 'hello') start(message);
  else if (message.kind === 'log') panel.setLog(message);
  else if (message.kind === 'sensor') sensor.addFile(message);
  else if (message.kind === 'saved') actors.saved(message.folder);
  else if (message.kind === 'ground') actors.placed(message);
  else if (message.about === 'sensor') sensor.say(message.text, true);
  else if (message.about === 'save' || message.about === 'ground') actors.say(message.text, true);
  else if (actors.takeBack()) panel.tell(`The last edit of the actors was undone: ${message.text}`);
  else panel.say(message.text, true);
}

function lost(pause, isLocked) {
  panel.say(isLocked ? 'The server was restarted and needs a new access token. Open the address that it has printed.'
    : `The server has ended or cannot be reached. Trying again in ${pause} s.`, true);
}

/**
 * Handles a new connection to the program: requests again all data that the page shows.
 */
function start(message) {
  const before = hello;
  hello = message;
  element('run-name').textContent = hello.run;
  element('log-name').textContent = `${hello.log} · ${hello.frames.length} frames · ${hello.surfels.toLocaleString('en')} surfels · ${hello.device}`;
  document.title = `${hello.run} – relidar view`;
  element('save-name').title = `a folder in ${hello.save_folder}`;
  actors.load(hello);
  panel.setChannels(hello.channels);
  settle(before ? () => resume(before) : restore);
}

function settle(change) {
  isSettling = true;
  change();
  isSettling = false;
  refresh();
}

/**
 * Restores the state after a lost connection, unless the program now serves another run.
 */
function resume(before) {
  const isSame = hello.identity === before.identity;
  const lostSensor = sensor.load(hello);
  panel.waitForLog();
  if (sensor.wish.sensor === 'file') send(sensor.file);
  if (!isSame) startAnew();
  timeline.load(hello.frames, isSame ? timeline.time : undefined);
  if (!isSame) panel.tell(`The server now shows the run ${hello.run} instead of ${before.run}. Position, time and edits of the previous run are discarded.`);
  else if (lostSensor) panel.tell("The server no longer has this sensor. The sensor of the log is shown instead.");
}

function startAnew() {
  actors.restore(null, false);
  sensor.setPlace(NOWHERE);
}

/** Restores the state from the URL. Ignores parts of another run and invalid parts. */
function restore(hash = location.hash) {
  const { parts, wrong } = readAddress(hash);
  const isSame = parts.run === undefined || parts.run === hello.identity;
  const notes = wrong.length ? [`Some parts of the address are invalid and are ignored: ${wrong.join('; ')}.`] : [];
  if (!isSame) notes.push('The address belongs to another run. Its position, time and edits are ignored.');
  sensor.load(hello);
  if (parts.sensor === 'file' && !sensor.file) notes.push("Choose the sensor file again. Until then, the sensor of the log is shown.");
  if (!sensor.choose(parts.sensor ?? 'native', parts.lidar ?? 0) && parts.sensor !== 'file')
    notes.push("The address names an unknown sensor. The sensor of the log is shown instead.");
  sensor.weather.value = parts.weather ?? '';
  panel.look = { colour: parts.colour, size: parts.size, layers: parts.layers };
  if (parts.camera) camera.restore(isSame ? parts.camera : { ...parts.camera, mode: 'follow' });
  panel.markCamera(camera.mode);
  panel.setMode(parts.show ?? 'simulated');
  startAnew();
  if (isSame && parts.edits) actors.restore(parts.edits, parts.saved === '1');
  if (isSame && parts.place) sensor.setPlace(parts.place);
  timeline.load(hello.frames, isSame ? parts.time : undefined);
  panel.tell(notes.join(' '));
}

let remembering = null;   // Timer of a pending change of the URL.

function remember() {
  if (hello) remembering ??= setTimeout(writeHash, ADDRESS_PAUSE_MS);
}

function writeHash() {
  clearTimeout(remembering);
  remembering = null;
  if (!hello) return;
  const { sensor: name, lidar, weather, place } = sensor.wish;
  const { hash, holdsEdits } = writeAddress({
    run: hello.identity, sensor: name, lidar, weather, time: timeline.time, place, show: panel.wanted ?? panel.mode, ...panel.look, camera,
    edits: actors.edits, saved: !actors.isUnsaved,
  });
  if (!holdsEdits) panel.tell('There are too many edits to store them in the address. Save them as a run, because reloading the page discards them.');
  if (hash !== location.hash) history.replaceState(null, '', hash);
}

function received(next, asked) {
  frame = next;
  const { header } = frame;
  actors.accept(asked.edits);
  camera.track([header.pose[12], header.pose[13], header.pose[14]], headingOf(header.pose));
  actors.update(header.actors, header.instances);
  if (header.actor_notes) element('actor-notes').textContent = header.actor_notes.join(' ');
  if (frame.simulated) beams.fit(frame.simulated.ring);
  panel.setNumbers(frame);
  show();
}

const shownOf = (scan) => (i) => scan.range[i] > 0 && beams.has(scan.ring[i]) && (panel.shows.dropped || returned(scan, i));

const linesOf = ({ position, rgba }) => [position, rgba];

function show() {
  if (!frame) return redraw();
  const { header, simulated, real } = frame;
  const error = header.matched ? rangeErrors(simulated, real) : null;
  const options = (scan) => ({ maxRange: hello.max_range_m, sensorHeight: header.pose[14], error, shown: shownOf(scan) });
  const colours = simulated && coloursOf(simulated, panel.colouring, options(simulated));
  const realColours = real && (simulated ? flatColours(real.range.length, panel.realColour, shownOf(real)) : coloursOf(real, panel.colouring, options(real)));
  setCloud('simulated', simulated, colours, 1);
  setCloud('real', real, realColours, simulated ? REAL_SIZE : 1);
  setErrorLines(error);
  setScenery(header);
  showStrips(colours, real && coloursOf(real, panel.colouring, options(real)));
  showLegend();
  redraw();
}

/** [n] in metres; NaN if either ray has no return. */
function rangeErrors(simulated, real) {
  return simulated.range.map((r, i) => (returned(simulated, i) && returned(real, i) ? Math.abs(r - real.range[i]) : NaN));
}

function setCloud(name, scan, rgba, size) {
  if (scan) view.setPoints(name, scan.position, rgba, size);
  else view.remove(name);
}

function setErrorLines(error) {
  if (!error || !panel.shows.errors || panel.mode !== 'both') return view.remove('errors');
  const which = [];
  error.forEach((e, i) => { if (e > SHORTEST_ERROR_M && beams.has(frame.simulated.ring[i])) which.push(i); });
  return view.setLines('errors', ...linesOf(shapes.pairs(frame.simulated.position, frame.real.position, which, [214, 48, 60, 180])));
}

function setScenery(header) {
  const ground = [header.log_pose[12], header.log_pose[13], header.log_pose[14] - SENSOR_HEIGHT_M];
  const gray = DARK.matches ? [46, 53, 62, 255] : [214, 219, 226, 255];
  setLines('grid', panel.shows.grid, () => shapes.grid(ground, GRID_REACH_M, gray));
  setLines('axes', true, () => shapes.axes(header.pose, panel.shows.grid ? 2 : 1));
  setLines('boxes', panel.shows.boxes, () => shapes.boxes(actors.boxes.map((b) => ({ ...b, colour: [...instanceColour(b.instance), 255] }))));
  setLines('path', panel.shows.path, () => shapes.path(hello.frames.filter((f) => f.lidar === 0).map((f) => f.position), [21, 110, 220, 255]));
}

function setLines(name, wanted, make) {
  if (wanted) view.setLines(name, ...linesOf(make()));
  else view.remove(name);
}

function showStrips(colours, realColours) {
  const { simulated, real } = frame;
  const both = Boolean(simulated && real);
  element('strips').classList.toggle('two', both);
  element('strip').hidden = !simulated;
  element('real-strip').hidden = !real;
  const images = [simulated && strip.show(simulated, colours), real && realStrip.show(real, realColours)];
  if (images.includes(false)) tellPixel('This sensor has no rows and columns, so its scan has no range image.');
}

const shortNumber = (x) => String(Number(x.toPrecision(3)));

function showLegend() {
  const { label, unit, ends, map } = colouringOf(panel.colouring, frame.simulated);
  const limits = ends ? ends({ maxRange: hello.max_range_m }) : null;
  element('legend-low').textContent = limits ? shortNumber(limits[0]) : '';
  element('legend-high').textContent = limits ? `${shortNumber(limits[1])} ${unit}` : '';
  element('legend-bar').hidden = !limits;
  element('legend-bar').style.background = limits ? cssGradient(map) : '';
  element('legend-name').textContent = panel.colouring === 'error' && !frame.header.matched ? `${label}: only at the time and position of a real frame` : label;
  element('legend-real').hidden = panel.mode !== 'both';
}

function redraw() {
  remember();
  if (!drawn) return;
  drawn = false;
  requestAnimationFrame(() => {
    drawn = true;
    view.background = DARK.matches ? [0.043, 0.055, 0.071] : [0.969, 0.973, 0.98];
    view.pointSize = panel.pointSize;
    view.draw(camera);
  });
}

function setCamera(mode) {
  camera.setMode(mode);
  if (frame) camera.track([frame.header.pose[12], frame.header.pose[13], frame.header.pose[14]], headingOf(frame.header.pose));
  panel.markCamera(mode);
  redraw();
}

function clicked(xy) {
  if (!frame || !actors.placing) return;
  const scan = frame.simulated ?? frame.real;
  const at = pickGround(camera, view.aspect, xy, scan, shownOf(scan), frame.header.pose[14] - SENSOR_HEIGHT_M);
  if (!at) actors.say('There is no ground where you clicked, because the click points at the sky. Click on the ground.', true);
  else if (!send({ do: 'ground', ...actors.placing, at })) actors.say('The server cannot be reached.', true);
}

const CAMERAS = ['follow', 'orbit', 'fly'];
document.querySelectorAll('[data-camera]').forEach((b) => b.addEventListener('click', () => setCamera(b.dataset.camera)));
steer(view, camera, {
  onChange: () => { panel.markCamera(camera.mode); redraw(); },
  onGround: (from, to) => frame && sensor.drag(to[0] - from[0], to[1] - from[1], headingOf(frame.header.log_pose)),
  planeHeight: () => (frame ? frame.header.pose[14] - SENSOR_HEIGHT_M : 0),
  onClick: clicked,
});
const openHelp = setUpHelp();
const fly = (ahead, left) => () => { camera.move(ahead, left, 0); panel.markCamera(camera.mode); redraw(); };
bindKeys({
  0: () => sensor.setPlace(NOWHERE), escape: () => { if (actors.placing) actors.place(null); },
  ' ': () => timeline.toggle(), ',': () => timeline.step(-1), '.': () => timeline.step(1),
  1: () => panel.setMode('simulated'), 2: () => panel.setMode('real'), 3: () => panel.setMode('both'),
  c: () => setCamera(CAMERAS[(CAMERAS.indexOf(camera.mode) + 1) % 3]), '?': openHelp,
  arrowup: fly(1, 0), arrowdown: fly(-1, 0), arrowleft: fly(0, 1), arrowright: fly(0, -1),
}, makeDriver((...moved) => sensor.drive(...moved)));
giveBackFocus(element('view'));
DARK.addEventListener('change', show);
new ResizeObserver(redraw).observe(element('view'));
window.addEventListener('pagehide', writeHash);
// This event fires if the user types a URL or follows a link. It does not fire after
// replaceState(). writeHash() may already have replaced the typed fragment.
window.addEventListener('hashchange', ({ newURL }) => { if (hello) settle(() => restore(new URL(newURL).hash)); });
window.addEventListener('beforeunload', (event) => {
  writeHash();
  if (!actors.isUnsaved) return;
  event.preventDefault();
  event.returnValue = true;   // For browsers from before 2024.
});
// Removes the access token from the URL, because other people may see the screen. The
// token is now stored in a cookie.
if (location.search) history.replaceState(null, '', `/${location.hash}`);
drawn = true;
redraw();
