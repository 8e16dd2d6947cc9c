// SPDX-License-Identifier: Apache-2.0
// Stores the state of the page in the fragment of its URL. A reload, a bookmark or a link
// then restores the same state.

// Maximum length of a URL fragment. All browsers and mail programs preserve fragments of
// this length.
const LONGEST = 30000;
const MODES = ['simulated', 'real', 'both'];
const CAMERAS = ['follow', 'orbit', 'fly'];

const fail = (expected) => { throw new Error(expected); };
const rounded = (numbers) => numbers.map((v) => Math.round(v * 1000) / 1000).join(',');
const oneOf = (names) => (text) => (names.includes(text) ? text : fail(`one of ${names.join(', ')}`));
const text = (given) => (given && given.length <= 64 ? given : fail('a name'));
const areNumbers = (list, n) => Array.isArray(list) && list.length === n && list.every(Number.isFinite);

function numbers(n, limit) {
  return (given) => {
    const list = given.split(',').map((v) => (v.trim() === '' ? NaN : Number(v)));
    return areNumbers(list, n) && list.every((v) => Math.abs(v) <= limit) ? list : fail(`${n} number${n > 1 ? 's' : ''} from -${limit} to ${limit}`);
  };
}

function camera(given) {
  const [mode, ...rest] = given.split(',');
  const [yaw, pitch, distance, ...target] = numbers(6, 1e6)(rest.join(','));
  return { mode: oneOf(CAMERAS)(mode), yaw, pitch, distance, target };
}

function edits(given) {
  const expected = 'edits in the form that this page writes';
  let all;
  try {
    all = JSON.parse(given);
  } catch {
    fail(expected);
  }
  const { copies, moves, removed, hidden } = all ?? {};
  const areTracks = (list) => Array.isArray(list) && list.every((t) => typeof t === 'string');
  const areCopies = Array.isArray(copies)
    && copies.every((c) => typeof c?.of === 'string' && typeof c.from === 'string' && areNumbers(c.at, 7));
  const areMoves = moves !== null && typeof moves === 'object' && !Array.isArray(moves) && Object.values(moves).every((by) => areNumbers(by, 4));
  return areCopies && areMoves && areTracks(removed) && areTracks(hidden) ? { copies, moves, removed, hidden } : fail(expected);
}

/** Parsers of the parts. Each throws a description of the expected value. */
const READERS = {
  run: text,
  sensor: text,
  lidar: (given) => numbers(1, 1000)(given)[0],
  weather: text,
  time: (given) => numbers(1, 1e10)(given)[0],
  place: numbers(6, 10000),
  show: oneOf(MODES),
  colour: text,
  size: (given) => numbers(1, 8)(given)[0],
  layers: (given) => given.split(',').filter(Boolean),
  camera,
  edits,
  saved: oneOf(['1']),
};

/**
 * @return {parts, wrong}: the parsed parts by name, and descriptions of the invalid parts
 */
export function readAddress(hash) {
  const parts = {};
  const wrong = [];
  for (const [name, given] of new URLSearchParams(hash.replace(/^#/, ''))) {
    try {
      parts[name] = (Object.hasOwn(READERS, name) ? READERS[name] : () => fail('a name that this page uses'))(given);
    } catch (error) {
      wrong.push(`${name.slice(0, 20)}=${given.slice(0, 40)} (expected ${error.message})`);
    }
  }
  return { parts, wrong };
}

/** @return {hash, holdsEdits} */
export function writeAddress(parts) {
  const { camera: c, edits: changes } = parts;
  const list = new URLSearchParams({
    run: parts.run,
    sensor: parts.sensor,
    lidar: String(parts.lidar),
    weather: parts.weather,
    time: String(parts.time),
    place: rounded(parts.place),
    show: parts.show,
    colour: parts.colour,
    size: String(parts.size),
    layers: parts.layers.join(','),
    camera: `${c.mode},${rounded([c.yaw, c.pitch, c.distance, ...c.target])}`,
  });
  const hasEdits = changes.copies.length + changes.removed.length + changes.hidden.length + Object.keys(changes.moves).length > 0;
  const without = list.toString();
  if (hasEdits) list.set('edits', JSON.stringify(changes));
  if (hasEdits && parts.saved) list.set('saved', '1');
  const full = list.toString().replaceAll('%2C', ',');
  const holdsEdits = full.length <= LONGEST;
  return { hash: `#${holdsEdits ? full : without}`, holdsEdits };
}
