// SPDX-License-Identifier: Apache-2.0
// Computes the colours of points for a colour scheme. Colour stops are interpolated
// linearly. Each colour map also varies in lightness.

const TURBO = [[38, 24, 84], [62, 84, 204], [46, 156, 246], [30, 216, 184], [120, 246, 92], [210, 232, 50], [248, 162, 46], [216, 64, 16],
  [132, 12, 8]];
const GLOW = [[58, 28, 110], [92, 52, 160], [84, 108, 190], [52, 150, 170], [60, 186, 130], [150, 206, 70], [250, 226, 60]];
const ALARM = [[40, 150, 160], [120, 190, 150], [240, 200, 70], [236, 120, 40], [206, 30, 40]];
const INSTANCES = [[31, 111, 235], [217, 88, 15], [18, 150, 107], [176, 56, 156], [190, 150, 20], [91, 75, 209], [209, 47, 75],
  [76, 143, 181]];
const BACKGROUND = [128, 136, 148];
const UNKNOWN = [128, 128, 132];

const table = (stops) => Array.from({ length: 256 }, (_, i) => {
  const place = (i / 255) * (stops.length - 1);
  const low = Math.min(Math.floor(place), stops.length - 2);
  return stops[low].map((c, k) => Math.round(c + (place - low) * (stops[low + 1][k] - c)));
});
const TABLES = { turbo: table(TURBO), glow: table(GLOW), alarm: table(ALARM) };

/**
 * Colour schemes: label, unit, limits, colour map, and the position of a value in the map
 * (0..1). Ranges and intensities use the square root, because most points of a scan are
 * near and dark.
 */
export const COLOURINGS = {
  range: { label: 'range', unit: 'm', map: 'turbo', ends: (o) => [0, o.maxRange], share: (v, [, b]) => Math.sqrt(v / b) },
  intensity: { label: 'intensity', unit: '', map: 'glow', ends: () => [0, 1], share: (v) => Math.sqrt(v) },
  height: { label: 'height over the sensor', unit: 'm', map: 'turbo', ends: () => [-3, 6], share: (v, [a, b]) => (v - a) / (b - a) },
  drop: { label: 'drop probability', unit: '', map: 'alarm', ends: () => [0, 1], share: (v) => v },
  error: { label: 'range error', unit: 'm', map: 'alarm', ends: () => [0, 1], share: (v, [a, b]) => (v - a) / (b - a) },
  instance: { label: 'instance', unit: '', map: null },
};

/**
 * Returns the channel of a colour scheme "channel:NAME", if the scan has this channel.
 */
const channelOf = (colouring, scan) => (colouring.startsWith('channel:') ? scan?.channels?.[colouring.slice('channel:'.length)] : undefined);

/**
 * Returns the colour scheme of a channel. Numbers are scaled to their limits in the scan,
 * vectors are RGB, and integers are coloured like instances.
 */
function channelColouring(colouring, scan) {
  const label = colouring.slice('channel:'.length);
  const channel = channelOf(colouring, scan);
  if (!channel || channel.components === 3 || channel.isInteger) return { label, unit: '', map: null };
  let low = 0;
  let high = 1;   // default maximum, because most channels are fractions
  for (const v of channel.values) if (Number.isFinite(v)) [low, high] = [Math.min(low, v), Math.max(high, v)];
  return { label, unit: '', map: 'turbo', ends: () => [low, high], share: (v, [a, b]) => (v - a) / (b - a) };
}

/** Returns a colour scheme by name: one of COLOURINGS, or "channel:NAME". */
export const colouringOf = (name, scan) => COLOURINGS[name] ?? channelColouring(name, scan);

/** Returns the colour of a point for a channel that is not a scalar. */
function channelColour({ values, components, isInteger }, i) {
  if (isInteger) return INSTANCES[Math.abs(values[i]) % INSTANCES.length];
  return [0, 1, 2].map((k) => Math.round(127.5 * (1 + values[components * i + k])));
}

/** Returns the value of each point of a scan for a colour scheme; NaN if unknown. */
function valueReader(scan, colouring, options) {
  if (colouring === 'range') return (i) => scan.range[i];
  if (colouring === 'intensity') return (i) => scan.intensity[i] / 255;
  if (colouring === 'height') return (i) => scan.position[3 * i + 2] - options.sensorHeight;
  if (colouring === 'drop') return (i) => scan.drop[i] / 255;
  const channel = channelOf(colouring, scan);
  if (channel) return (i) => channel.values[i];
  return (i) => (options.error ? options.error[i] : NaN);
}

export const instanceColour = (instance) => (instance === 0 || instance === 65535 ? BACKGROUND : INSTANCES[(instance - 1) % INSTANCES.length]);

/**
 * Returns the RGBA bytes of the points of a scan.
 * @param options {maxRange, sensorHeight, error, shown}; error is a Float32Array or null,
 * shown is (point) => boolean
 */
export function coloursOf(scan, colouring, options) {
  const n = scan.range.length;
  const rgba = new Uint8Array(4 * n);
  const { map, ends, share } = colouringOf(colouring, scan);
  const channel = channelOf(colouring, scan);
  const limits = ends ? ends(options) : null;
  const value = valueReader(scan, colouring, options);
  for (let i = 0; i < n; ++i) {
    if (!options.shown(i)) continue;   // keeps alpha 0, so that the point is not drawn
    let colour;
    if (!map && channel) {
      colour = channelColour(channel, i);
    } else if (!map) {
      colour = colouring === 'instance' && scan.instance ? instanceColour(scan.instance[i]) : UNKNOWN;
    } else {
      const v = value(i);
      colour = Number.isNaN(v) ? UNKNOWN : TABLES[map][Math.max(0, Math.min(255, Math.round(255 * share(v, limits))))];
    }
    rgba[4 * i] = colour[0];
    rgba[4 * i + 1] = colour[1];
    rgba[4 * i + 2] = colour[2];
    rgba[4 * i + 3] = 255;
  }
  return rgba;
}

/** Returns RGBA bytes with the same colour for all visible points. */
export function flatColours(n, colour, shown) {
  const rgba = new Uint8Array(4 * n);
  for (let i = 0; i < n; ++i) if (shown(i)) rgba.set([...colour, 255], 4 * i);
  return rgba;
}

/** Returns a colour map as a CSS gradient, from left to right. */
export function cssGradient(map) {
  const stops = { turbo: TURBO, glow: GLOW, alarm: ALARM }[map];
  return `linear-gradient(to right, ${stops.map((c) => `rgb(${c.join(' ')})`).join(', ')})`;
}
