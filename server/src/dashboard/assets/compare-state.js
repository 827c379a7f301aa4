// How the pictures are seen, as the address holds it: every view is a link.

export const MODES = ['side', 'swipe', 'flicker', 'difference', 'heat'];
export const TONE_MAPS = ['neutral', 'agx', 'none'];
export const COLOR_MAPS = ['viridis', 'magma', 'grey'];
const INTERVALS = [0.5, 1, 2];

const isWhole = (value, end) => Number.isInteger(value) && value >= 0 && value < end;
const number = (text) => (text === null || text.trim() === '' ? NaN : Number(text));
const within = (value, low, high, otherwise) => (value >= low && value <= high ? value : otherwise);
const oneOf = (value, known) => (known.includes(value) ? value : known[0]);
const list = (text, length) => {
  const values = (text ?? '').split(',').map(Number);
  return values.length === length && values.every(Number.isFinite) ? values : null;
};

// What the address says, for this many pictures. What it leaves out, or says wrongly, is as at first.
export function readState(count) {
  const query = new URLSearchParams(location.search);
  const range = (name) => (Number.isFinite(number(query.get(name))) ? number(query.get(name)) : null);
  const ref = number(query.get('ref'));
  const other = number(query.get('other'));
  const state = {
    mode: oneOf(query.get('mode'), MODES),
    ref: isWhole(ref, count) ? ref : 0,
    other: isWhole(other, count) ? other : 1,
    layer: query.get('layer') || 'color',
    ev: within(number(query.get('ev')), -16, 16, 0),
    tm: oneOf(query.get('tm'), TONE_MAPS),
    map: oneOf(query.get('map'), COLOR_MAPS),
    lo: range('lo'),
    hi: range('hi'),
    gain: within(number(query.get('gain')), 0.01, 100000, 1),
    at: within(number(query.get('at')), 0, 1, 0.5),
    every: within(number(query.get('every')), 0.5, 2, 1),
    // Device pixels per pixel of the pictures; null fits them into the view.
    zoom: within(number(query.get('z')), 0.01, 64, null),
    center: list(query.get('c'), 2),
    pixel: list(query.get('px'), 2),
    crop: list(query.get('crop'), 4),
    plain: query.get('plain') === '1',
    // Not in the address: a link does not start to blink.
    play: false,
    flipped: false,
  };
  if (!INTERVALS.includes(state.every)) state.every = 1;
  return state;
}

// Where the picture's top left corner is in a pane, in device pixels. Pixels that are as large as the screen's or larger
// begin where the screen's do, so that none falls between two.
export function originOf(pane, { zoom, center }) {
  const origin = [pane.width / 2 - center[0] * zoom, pane.height / 2 - center[1] * zoom];
  return zoom >= 1 ? origin.map(Math.round) : origin;
}

// The address of a view. What is as at first is left out.
export function addressOf(state, specs) {
  const query = new URLSearchParams();
  for (const spec of specs) query.append('p', spec);
  const put = (name, value, usual) => {
    if (value !== usual && value !== null) query.set(name, String(value));
  };
  const short = (value) => String(Math.round(value * 100) / 100);
  put('mode', state.mode, 'side');
  put('ref', state.ref, 0);
  put('other', state.other, 1);
  put('layer', state.layer, 'color');
  put('ev', state.ev, 0);
  put('tm', state.tm, 'neutral');
  put('map', state.map, 'viridis');
  put('lo', state.lo, null);
  put('hi', state.hi, null);
  put('gain', state.gain, 1);
  put('at', state.at, 0.5);
  put('every', state.every, 1);
  if (state.zoom !== null) put('z', Number(state.zoom.toPrecision(4)), null);
  if (state.zoom !== null && state.center) query.set('c', state.center.map(short).join(','));
  if (state.pixel) query.set('px', state.pixel.join(','));
  if (state.crop) query.set('crop', state.crop.join(','));
  if (state.plain) query.set('plain', '1');
  // Commas and slashes need no escape in a query, and links are read by people.
  return `/compare?${query.toString().replaceAll('%2C', ',').replaceAll('%2F', '/')}`;
}
