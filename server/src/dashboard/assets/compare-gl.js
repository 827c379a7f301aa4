// Draws pictures with WebGL2: colours as half floats, depths as floats, ids as the bytes of their integers.
import { FRAGMENT, VERTEX } from './compare-shaders.js';
import { TONE_MAPS, originOf } from './compare-state.js';

// Stops of the false colours at equal distances (magma and viridis of matplotlib, S. van der Walt and N. Smith, CC0).
const STOPS = {
  viridis: ['440154', '472d7b', '3b528b', '2c728e', '21918c', '28ae80', '5ec962', 'addc30', 'fde725'],
  magma: ['000004', '1d1147', '51127c', '832681', 'b73779', 'e55064', 'fb8761', 'fec287', 'fcfdbf'],
  grey: ['000000', 'ffffff'],
};

// 256 colours of a map, four bytes each.
export function colorTable(name) {
  const stops = STOPS[name].map((hex) => [0, 2, 4].map((i) => Number.parseInt(hex.slice(i, i + 2), 16)));
  const table = new Uint8ClampedArray(256 * 4);
  for (let i = 0; i < 256; i++) {
    const at = (i / 255) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    for (let c = 0; c < 3; c++) table[4 * i + c] = stops[low][c] + (at - low) * (stops[low + 1][c] - stops[low][c]);
    table[4 * i + 3] = 255;
  }
  return table;
}

export class GlRenderer {
  // Throws when the browser has no WebGL2.
  constructor(canvas) {
    const options = { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true };
    const gl = canvas.getContext('webgl2', options);
    if (!gl) throw new Error('no WebGL2');
    this.canvas = canvas;
    this.gl = gl;
    this.textures = new Map();
    this.tables = {};
    this.setUp();
    // What the graphics driver lost is asked for again.
    canvas.addEventListener('webglcontextlost', (event) => event.preventDefault());
    canvas.addEventListener('webglcontextrestored', () => {
      this.textures.clear();
      this.tables = {};
      this.setUp();
      this.onRestored?.();
    });
  }

  setUp() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? 'a shader');
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? 'a program');
    gl.useProgram(program);
    this.places = new Proxy({}, { get: (known, name) => (known[name] ??= gl.getUniformLocation(program, name)) });
    gl.bindVertexArray(gl.createVertexArray());
    gl.enable(gl.SCISSOR_TEST);
    ['first', 'second', 'colors'].forEach((name, unit) => gl.uniform1i(this.places[name], unit));
  }

  get limit() {
    return this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE);
  }

  // Keeps pixels under a key, for `draw`.
  put(key, pixels) {
    const { gl } = this;
    const texture = this.makeTexture();
    const { width, height, data, image, kind } = pixels;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    if (image && pixels.encoded) gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    else if (image) gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    else {
      const forms = [
        [gl.RGB16F, gl.RGB, gl.HALF_FLOAT],
        [gl.RGB16F, gl.RGB, gl.HALF_FLOAT],
        [gl.R32F, gl.RED, gl.FLOAT],
        [gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE],
      ];
      const [inside, format, type] = forms[kind];
      gl.texImage2D(gl.TEXTURE_2D, 0, inside, width, height, 0, format, type, data);
    }
    this.textures.set(key, { texture, width, height, kind });
  }

  makeTexture() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of ['TEXTURE_MIN_FILTER', 'TEXTURE_MAG_FILTER']) gl.texParameteri(gl.TEXTURE_2D, gl[name], gl.NEAREST);
    for (const name of ['TEXTURE_WRAP_S', 'TEXTURE_WRAP_T']) gl.texParameteri(gl.TEXTURE_2D, gl[name], gl.CLAMP_TO_EDGE);
    return texture;
  }

  has(key) {
    return this.textures.has(key);
  }

  // Lets go of everything but these keys.
  keepOnly(keys) {
    for (const [key, { texture }] of this.textures) {
      if (keys.has(key)) continue;
      this.gl.deleteTexture(texture);
      this.textures.delete(key);
    }
  }

  table(name) {
    const { gl } = this;
    if (!this.tables[name]) {
      this.tables[name] = this.makeTexture();
      const bytes = new Uint8Array(colorTable(name).buffer);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    }
    return this.tables[name];
  }

  // Draws panes: `{ key, second, left, top, width, height, clipLeft, clipWidth, displayed, encoded }` in device pixels
  // from the top left corner, all with one view `{ center, zoom, ... }`.
  draw(panes, view) {
    const { gl, canvas, places } = this;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.scissor(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.09, 0.094, 0.11, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    for (const pane of panes) {
      const first = this.textures.get(pane.key);
      const second = pane.second ? this.textures.get(pane.second) : first;
      if (!first || !second) continue;
      const bottom = canvas.height - pane.top - pane.height;
      gl.scissor(pane.clipLeft ?? pane.left, bottom, Math.max(pane.clipWidth ?? pane.width, 0), pane.height);
      [first.texture, second.texture, this.table(view.map)].forEach((texture, unit) => {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, texture);
      });
      gl.uniform4f(places.pane, pane.left, bottom, pane.width, pane.height);
      gl.uniform2f(places.origin, ...originOf(pane, view));
      gl.uniform1f(places.zoom, view.zoom);
      gl.uniform2i(places.size, first.width, first.height);
      gl.uniform1i(places.kind, pane.encoded ? 4 : first.kind);
      gl.uniform1i(places.difference, pane.second ? 1 : 0);
      gl.uniform1i(places.counted, view.counted ? 1 : 0);
      gl.uniform2i(places.displayed, pane.displayed ? 1 : 0, 0);
      gl.uniform1i(places.toneMap, TONE_MAPS.indexOf(view.tm));
      gl.uniform1f(places.exposure, 2 ** view.ev);
      gl.uniform2f(places.range, ...view.range);
      const [low, high] = view.range;
      gl.uniform1ui(places.low, Math.min(Math.max(Math.round(low), 0), 2 ** 32 - 1));
      gl.uniform1f(places.span, Math.max(high - low, 1e-30));
      gl.uniform1f(places.gain, view.gain);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
  }
}
