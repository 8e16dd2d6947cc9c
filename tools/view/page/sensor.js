// SPDX-License-Identifier: Apache-2.0
// Lets the user select the sensor, the weather, and the pose of the sensor relative to
// the log's sensor. The six numbers of the pose can be typed, or changed with keys and
// mouse.
import { bindNumberField } from './number_field.js';

const FIELDS = [['x', 'forward m', 0.5], ['y', 'left m', 0.5], ['z', 'up m', 0.25], ['yaw', 'turn left °', 5], ['pitch', 'pitch °', 1],
  ['roll', 'roll °', 1]];
const LIMITS = [10000, 10000, 10000, 360, 360, 360];

export class SensorPanel {
  constructor(onChange, send) {
    this.onChange = onChange;
    this.place = [0, 0, 0, 0, 0, 0];
    this.choice = document.getElementById('sensor');
    this.lidar = document.getElementById('lidar');
    this.weather = document.getElementById('weather');
    this.hint = document.getElementById('sensor-hint');
    this.inputs = FIELDS.map(([name, label, step], i) => this.makeInput(i, name, label, step));
    this.choice.addEventListener('change', () => onChange());
    this.lidar.addEventListener('change', () => onChange());
    this.weather.addEventListener('change', () => onChange());
    document.getElementById('reset-place').addEventListener('click', () => this.setPlace([0, 0, 0, 0, 0, 0]));
    document.getElementById('sensor-file').addEventListener('change', async ({ target }) => {
      const [file] = target.files;
      if (!file) return;
      this.file = { do: 'sensor', file: file.name, text: await file.text() };
      if (!send(this.file)) this.say('The server cannot be reached. The file was not read.', true);
    });
  }

  makeInput(i, name, label, step) {
    const input = Object.assign(document.createElement('input'), { type: 'number', step, value: 0, id: `place-${name}`, min: -LIMITS[i], max: LIMITS[i] });
    bindNumberField(input, {
      label, limit: LIMITS[i], get: () => this.place[i], say: (text) => this.say(text, true),
      set: (number) => { this.place[i] = number; this.onChange(); },
    });
    const field = document.createElement('label');
    field.append(label, input);
    document.getElementById('place').append(field);
    return input;
  }

  /**
   * Sets the available choices, once per connection. Keeps the current choice if it is
   * available. @return true if the chosen sensor is not available
   */
  load({ sensors, lidars, weather }) {
    const { sensor, lidar } = this.wish;
    this.weather.title = `${weather.help}; the colour "source" shows what caused each point`;
    document.getElementById('weathers').replaceChildren(...weather.examples.split(' ').map((text) => new Option(text)));
    const file = [...this.choice.options].find((o) => o.value === 'file');
    this.choice.replaceChildren(...sensors.map((name) => new Option(name === 'native' ? "native (the log's)" : name, name)), ...(file ? [file] : []));
    this.lidar.replaceChildren(...lidars.map(({ name, sensor: kind }, i) => new Option(name || kind, String(i))));
    document.getElementById('lidar-field').hidden = lidars.length < 2;
    return !this.choose(sensor, lidar);
  }

  choose(sensor, lidar) {
    this.choice.value = sensor;
    this.lidar.value = String(lidar);
    const isThere = this.choice.selectedIndex >= 0 && this.lidar.selectedIndex >= 0;
    if (this.choice.selectedIndex < 0) this.choice.value = 'native';
    if (this.lidar.selectedIndex < 0) this.lidar.value = '0';
    return isThere;
  }

  addFile({ name, rays }) {
    let option = [...this.choice.options].find((o) => o.value === 'file');
    if (!option) this.choice.add(option = new Option('', 'file'));
    option.textContent = name;
    this.choice.value = 'file';
    this.say(`${name}: ${rays.toLocaleString('en')} rays`, false);
    this.onChange();
  }

  say(text, isAlarm) {
    this.hint.textContent = text;
    this.hint.classList.toggle('alarm', isAlarm);
  }

  showPlace(i) {
    this.inputs[i].value = String(Math.round(this.place[i] * 1000) / 1000);
  }

  setPlace(place) {
    this.place = place.map((v, i) => {
      const turned = i < 3 ? v : ((((v + 180) % 360) + 360) % 360) - 180;
      return Math.max(-LIMITS[i], Math.min(LIMITS[i], turned));
    });
    this.inputs.forEach((_, i) => this.showPlace(i));
    this.onChange();
  }

  /** Moves the sensor in its own frame, in metres and degrees. */
  drive(ahead, left, up, turn) {
    const yaw = (this.place[3] * Math.PI) / 180;
    const [x, y, z, heading, pitch, roll] = this.place;
    this.setPlace([x + ahead * Math.cos(yaw) - left * Math.sin(yaw), y + ahead * Math.sin(yaw) + left * Math.cos(yaw), z + up, heading + turn, pitch, roll]);
  }

  /**
   * Moves the sensor over the ground. @param heading heading of the log's sensor in
   * radians
   */
  drag(dx, dy, heading) {
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    const [x, y, ...rest] = this.place;
    this.setPlace([x + c * dx + s * dy, y - s * dx + c * dy, ...rest]);
  }

  get wish() {
    return { place: [...this.place], sensor: this.choice.value || 'native', lidar: Number(this.lidar.value || 0), weather: this.weather.value.trim() || 'clear' };
  }
}
