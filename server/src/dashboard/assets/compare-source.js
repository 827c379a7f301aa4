// The pictures of the page: what they hold, their pixels, the values at one place, and the figures of a pair.
import { request, problemOf } from './problem.js';

const KINDS = { color: 0, vector: 1, scalar: 2, integer: 3 };
// Pixels whose values are kept.
const KEPT_PLACES = 200;

// One entry of the list of pictures.
export class Source {
  constructor(item) {
    const { spec, title, about, hash, file, png } = item.dataset;
    Object.assign(this, { spec, title, about, hash, file, png });
    this.layers = [];
    this.places = new Map();
  }

  // Reads what the picture holds.
  async open() {
    const found = await request(`${this.file}/layers`);
    this.width = found.width;
    this.height = found.height;
    this.displayed = found.display_referred;
    this.layers = found.layers;
    if (this.displayed) this.png ??= this.file;
  }

  layer(name) {
    return this.layers.find((layer) => layer.name === name);
  }

  // The pixels of a layer in the form that a texture takes: `{ kind, width, height, data }`, or a bitmap as `image`.
  async read(name) {
    const layer = this.layer(name);
    if (!layer) return null;
    if (this.displayed) return { kind: KINDS.color, image: await bitmap(this.file), width: this.width, height: this.height };
    const half = layer.kind === 'color' || layer.kind === 'vector';
    const response = await answer(half ? `${layer.href}?format=f16` : layer.href);
    const bytes = await response.arrayBuffer();
    const views = { color: Uint16Array, vector: Uint16Array, scalar: Float32Array, integer: Uint8Array };
    const data = new views[layer.kind](bytes);
    return { kind: KINDS[layer.kind], data, width: this.width, height: this.height };
  }

  // The values of all layers at a pixel, `null` outside of the picture.
  async valuesAt(x, y) {
    if (x < 0 || y < 0 || x >= this.width || y >= this.height) return null;
    const place = `${x},${y}`;
    if (!this.places.has(place)) {
      const found = await request(`${this.file}/pixel?x=${x}&y=${y}`);
      if (this.places.size >= KEPT_PLACES) this.places.delete(this.places.keys().next().value);
      this.places.set(place, found.layers);
    }
    return this.places.get(place);
  }
}

// Whether integers of a layer are counts, whose size means something, and not ids.
export function isCounted(layer) {
  return layer.kind === 'integer' && !layer.name.endsWith('_id') && layer.non_finite === 0;
}

// The figures of `b` against `a`, with the addresses of heat map and difference.
export function compare(a, b, layer, exposure) {
  const body = { a: { blob: a.hash, layer }, b: { blob: b.hash, layer }, exposure };
  const headers = { 'Content-Type': 'application/json' };
  return request('/v1/compare', { method: 'POST', headers, body: JSON.stringify(body) });
}

export async function bitmap(address) {
  const response = await answer(address);
  return createImageBitmap(await response.blob(), { colorSpaceConversion: 'none', premultiplyAlpha: 'none' });
}

async function answer(address) {
  let response;
  try {
    response = await fetch(address);
  } catch {
    throw { title: 'The service does not answer', detail: 'Check the connection and try again.', errors: [] };
  }
  if (!response.ok) throw problemOf(response.status, await response.text());
  return response;
}
