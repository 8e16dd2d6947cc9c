// SPDX-License-Identifier: Apache-2.0
// Draws points and lines on a canvas with WebGL 2. Point clouds and line sets have names.
// A new cloud or line set replaces the old one with the same name.

const POINTS = `#version 300 es
uniform mat4 clip_from_world;
uniform float size;
in vec3 position;
in vec4 colour;
out vec4 shade;
void main() {
  shade = colour;
  gl_Position = colour.a > 0.0 ? clip_from_world * vec4(position, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);   // outside: not drawn
  gl_PointSize = size * clamp(25.0 / gl_Position.w, 0.6, 2.5);
}`;
const LINES = `#version 300 es
uniform mat4 clip_from_world;
in vec3 position;
in vec4 colour;
out vec4 shade;
void main() { shade = colour; gl_Position = clip_from_world * vec4(position, 1.0); }`;
const ROUND = `#version 300 es
precision mediump float;
in vec4 shade;
out vec4 pixel;
void main() {
  vec2 d = gl_PointCoord - 0.5;
  if (dot(d, d) > 0.25) discard;
  pixel = shade;
}`;
const PLAIN = `#version 300 es
precision mediump float;
in vec4 shade;
out vec4 pixel;
void main() { pixel = vec4(shade.rgb * shade.a, shade.a); }`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.bindAttribLocation(made, 0, 'position');
  gl.bindAttribLocation(made, 1, 'colour');
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(`WebGL: ${gl.getProgramInfoLog(made)}`);
  return { made, matrix: gl.getUniformLocation(made, 'clip_from_world'), size: gl.getUniformLocation(made, 'size') };
}

export class CloudView {
  /** Creates a view. @throws Error if the browser does not support WebGL 2 */
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext('webgl2', { antialias: true });
    if (!this.gl) throw new Error('this browser has no WebGL 2, which the view in 3D needs');
    this.points = program(this.gl, POINTS, ROUND);
    this.lines = program(this.gl, LINES, PLAIN);
    this.shapes = new Map();
    this.pointSize = 3;
    this.background = [0, 0, 0];
  }

  /**
   * Sets the points with a name.
   * @param position Float32Array, three values for each point
   * @param rgba Uint8Array, four bytes for each point
   * @param size factor on the point size of the view
   */
  setPoints(name, position, rgba, size = 1) {
    this.set(name, position, rgba, true);
    this.shapes.get(name).size = size;
  }

  /**
   * Sets the lines with a name.
   * @param position Float32Array, two points for each line
   * @param rgba Uint8Array, four bytes for each point
   */
  setLines(name, position, rgba) { this.set(name, position, rgba, false); }

  remove(name) {
    const shape = this.shapes.get(name);
    if (!shape) return;
    this.gl.deleteBuffer(shape.position);
    this.gl.deleteBuffer(shape.colour);
    this.gl.deleteVertexArray(shape.array);
    this.shapes.delete(name);
  }

  set(name, position, rgba, isPoints) {
    const { gl } = this;
    let shape = this.shapes.get(name);
    if (!shape) {
      shape = { array: gl.createVertexArray(), position: gl.createBuffer(), colour: gl.createBuffer(), isPoints };
      gl.bindVertexArray(shape.array);
      gl.bindBuffer(gl.ARRAY_BUFFER, shape.position);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, shape.colour);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
      this.shapes.set(name, shape);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, shape.position);
    gl.bufferData(gl.ARRAY_BUFFER, position, gl.DYNAMIC_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, shape.colour);
    gl.bufferData(gl.ARRAY_BUFFER, rgba, gl.DYNAMIC_DRAW);
    shape.count = position.length / 3;
  }

  get aspect() { return this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight); }

  draw(camera) {
    const { gl, canvas } = this;
    const density = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(canvas.clientWidth * density));
    const height = Math.max(1, Math.round(canvas.clientHeight * density));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(...this.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const matrix = new Float32Array(camera.matrix(this.aspect));
    for (const wanted of [false, true]) {
      const { made, matrix: place, size } = wanted ? this.points : this.lines;
      gl.useProgram(made);
      gl.uniformMatrix4fv(place, false, matrix);
      for (const { array, isPoints, count, size: factor } of this.shapes.values()) {
        if (isPoints !== wanted || !count) continue;
        if (isPoints) gl.uniform1f(size, this.pointSize * density * factor);
        gl.bindVertexArray(array);
        gl.drawArrays(isPoints ? gl.POINTS : gl.LINES, 0, count);
      }
    }
  }
}
