// SPDX-License-Identifier: Apache-2.0
// Decodes a scan message in the format of tools/view/frame.hpp.

const TYPES = { f32: Float32Array, i32: Int32Array, u8: Uint8Array, u16: Uint16Array };

/**
 * @return {header, simulated, real}: scans as {rows, columns, position, range, intensity,
 * drop, instance, ring, channels}, or null if missing; channels by name are {values,
 * components, isInteger}
 */
export function decodeFrame(buffer) {
  const view = new DataView(buffer);
  const magic = String.fromCharCode(...new Uint8Array(buffer, 0, 4));
  if (magic !== 'RLV1') throw new Error(`cannot read a scan from the server: it begins with ${magic}, expected RLV1`);
  const start = 8 + view.getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, start - 8)));
  const arrays = {};
  const channels = {};
  for (const { name, type, components, count, offset } of header.arrays) {
    arrays[name] = new TYPES[type](buffer, start + offset, components * count);
    if (name.startsWith('channel_')) channels[name.slice('channel_'.length)] = { values: arrays[name], components, isInteger: type === 'i32' };
  }
  const scan = (prefix, image) => image && {
    rows: image[0],
    columns: image[1],
    channels: prefix ? {} : channels,   // Measured scans have no channels.
    ...Object.fromEntries(['position', 'range', 'intensity', 'drop', 'instance', 'ring'].map((name) => [name, arrays[prefix + name]])),
  };
  return { header, simulated: scan('', header.image) ?? null, real: scan('real_', header.real_image) ?? null };
}

/**
 * Returns true if a ray has a return: it hits a surface, and its drop probability is
 * below one half.
 */
export const returned = (scan, i) => scan.drop[i] < 128 && scan.range[i] > 0;
