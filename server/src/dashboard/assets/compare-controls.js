// The controls around the pictures: fields, buttons, keys, figures.
import { element, notice } from './problem.js';
import { MODES, TONE_MAPS } from './compare-state.js';
import { isCounted } from './compare-source.js';

const MODE_KEYS = { s: 'side', w: 'swipe', f: 'flicker', d: 'difference', h: 'heat' };
const FIGURES = [
  ['RMSE', 'rmse'],
  ['Relative MSE', 'rel_mse'],
  ['Mean FLIP', 'flip_mean'],
  ['FLIP, 99th percentile', 'flip_p99'],
  ['SSIM', 'ssim'],
  ['Mean ratio', 'mean_ratio'],
  ['Largest difference', 'max_difference'],
];

export class Controls {
  constructor(comparison) {
    this.comparison = comparison;
    this.root = comparison.root;
    this.bar = this.root.querySelector('.compare-bar');
    this.fields = this.bar.elements;
    this.help = document.getElementById('shortcuts');
    this.listen();
  }

  get state() {
    return this.comparison.state;
  }

  offerLayers(names) {
    const options = names.map((name) => Object.assign(element('option', name.replaceAll('_', ' ')), { value: name }));
    this.fields.layer.replaceChildren(...options);
    if (!names.includes(this.state.layer)) this.comparison.state.layer = names[0];
  }

  listen() {
    const { comparison, root, bar } = this;
    bar.addEventListener('submit', (event) => event.preventDefault());
    bar.addEventListener('input', (event) => this.read(event.target));
    bar.addEventListener('change', (event) => this.read(event.target));
    bar.addEventListener('click', (event) => {
      const button = event.target.closest('[data-zoom]');
      if (button) comparison.view.zoomButton(button.dataset.zoom);
    });
    root.querySelector('[data-crop-go]').addEventListener('click', () => comparison.view.showCrop());
    root.querySelector('[data-crop-clear]').addEventListener('click', () => comparison.change({ crop: null }));
    document.querySelector('[data-show-help]').addEventListener('click', () => this.help.showModal());
    document.querySelector('[data-copy-link]').addEventListener('click', (event) => this.copyLink(event.currentTarget));
    document.addEventListener('keydown', (event) => this.key(event));
  }

  // A field's value into the state; what it may not be stays as it was.
  read(field) {
    const { name, value } = field;
    const number = value === '' ? null : Number(value);
    const isNumber = number !== null && Number.isFinite(number) && field.validity.valid;
    const changes = {
      mode: () => ({ mode: value }),
      ref: () => ({ ref: Number(value) }),
      other: () => ({ other: Number(value) }),
      layer: () => ({ layer: value, lo: null, hi: null }),
      tm: () => ({ tm: value }),
      map: () => ({ map: value }),
      play: () => ({ play: field.checked }),
      every: () => ({ every: Number(value) }),
      ev: () => isNumber && { ev: number },
      at: () => isNumber && { at: number },
      gain: () => isNumber && { gain: number },
      lo: () => field.validity.valid && { lo: number },
      hi: () => field.validity.valid && { hi: number },
    }[name]?.();
    if (changes) this.comparison.change(changes);
  }

  // The state into the fields, and those that have a meaning now.
  show() {
    const { state, fields } = this;
    const put = (field, value) => {
      if (document.activeElement !== field || field.type !== 'number') field.value = value ?? '';
    };
    for (const input of fields.mode) input.checked = input.value === state.mode;
    for (const name of ['ref', 'other', 'layer', 'ev', 'tm', 'map', 'lo', 'hi', 'gain', 'at', 'every']) put(fields[name], state[name]);
    fields.play.checked = state.play;
    const layer = this.comparison.layer();
    const isValue = layer.kind === 'scalar' || layer.kind === 'vector' || isCounted(layer);
    const shown = {
      'for-color': layer.kind === 'color' && !state.plain && state.mode !== 'heat',
      'for-light': layer.name === 'color' && !state.plain && state.mode !== 'heat' && state.mode !== 'difference',
      'for-values': isValue && state.mode !== 'heat',
      'for-map': isValue && layer.kind !== 'vector' && state.mode !== 'heat',
      'for-difference': state.mode === 'difference',
      'for-swipe': state.mode === 'swipe',
      'for-flicker': state.mode === 'flicker',
    };
    for (const [name, isShown] of Object.entries(shown)) {
      for (const group of this.bar.querySelectorAll(`.${name}`)) group.hidden = !isShown;
    }
    const isPair = state.mode !== 'side' || this.comparison.sources.length > 2;
    for (const label of this.bar.querySelectorAll('.pair')) label.hidden = !isPair || this.comparison.sources.length < 3;
    this.showCrop();
  }

  showCrop() {
    const panel = this.root.querySelector('[data-crop]');
    panel.hidden = !this.state.crop;
    if (!this.state.crop) return;
    const [x, y, width, height] = this.state.crop;
    panel.querySelector('[data-crop-text]').textContent = `${width} × ${height} pixels at ${x}, ${y}. The link of this page shows it.`;
  }

  showScale(zoom) {
    const percent = zoom * 100;
    this.fields.scale.value = `${percent < 10 ? percent.toFixed(1) : Math.round(percent)} %`;
  }

  showFigures(found, problem) {
    const list = this.root.querySelector('[data-figures]');
    const box = this.root.querySelector('[data-figures-problem]');
    const letter = (index) => String.fromCharCode(65 + index);
    this.root.querySelector('[data-pair]').textContent = `${letter(this.state.other)} against ${letter(this.state.ref)}, ${this.state.layer.replaceAll('_', ' ')}`;
    box.replaceChildren(...(problem ? [notice({ ...problem, errors: problem.errors ?? [] })] : []));
    if (!found) {
      list.replaceChildren(...(problem ? [] : [row('Comparing', '…')]));
      return;
    }
    const share = ((100 * found.differing_pixels) / found.pixels).toFixed(found.differing_pixels && found.differing_pixels < found.pixels / 1000 ? 4 : 1);
    const rows = FIGURES.map(([title, name]) => row(title, found[name] === null ? 'none' : String(Number(found[name].toPrecision(4)))));
    rows.push(row('Differing pixels', `${found.differing_pixels} of ${found.pixels} (${share} %)`));
    if (found.non_finite_pixels > 0) rows.push(row('Not finite', String(found.non_finite_pixels)));
    list.replaceChildren(...rows);
  }

  async copyLink(button) {
    const before = button.textContent;
    try {
      await navigator.clipboard.writeText(location.href);
      button.textContent = 'Copied';
    } catch {
      // Without a secure context there is no clipboard.
      button.textContent = 'It is in the address bar';
    }
    this.comparison.say(button.textContent);
    setTimeout(() => (button.textContent = before), 1500);
  }

  key(event) {
    const typing = event.target.closest('input:not([type=radio], [type=checkbox], [type=range]), select, textarea, dialog');
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const onStage = this.comparison.stage.contains(event.target);
    const done = this.stageKey(event, onStage) || this.pageKey(event);
    if (done) event.preventDefault();
  }

  // Keys that elsewhere scroll the page or press a button.
  stageKey(event, onStage) {
    const { view } = this.comparison;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const arrow = arrows[event.key];
    if (!onStage) return false;
    if (arrow && event.shiftKey) view.movePixel(...arrow);
    else if (arrow) view.moveBy(0.1 * arrow[0], 0.1 * arrow[1]);
    else if (event.key === ' ') this.flip();
    else return false;
    return true;
  }

  flip() {
    this.comparison.change({ mode: 'flicker', play: false, flipped: !this.state.flipped });
    const index = this.state.flipped ? this.state.other : this.state.ref;
    this.comparison.say(`Picture ${String.fromCharCode(65 + index)}`);
  }

  pageKey(event) {
    const { comparison, state } = this;
    const { view } = comparison;
    const key = event.key.toLowerCase();
    const mode = MODE_KEYS[key];
    if (mode && MODES.includes(mode)) comparison.change({ mode });
    else if (key >= '1' && key <= '8' && Number(key) <= comparison.sources.length) comparison.change({ other: Number(key) - 1 });
    else if (key === '[' || key === ']') this.nextLayer(key === ']' ? 1 : -1);
    else if (key === 'e') comparison.change({ ev: Math.min(Math.max(state.ev + (event.shiftKey ? -0.5 : 0.5), -16), 16) });
    else if (key === 't') comparison.change({ tm: TONE_MAPS[(TONE_MAPS.indexOf(state.tm) + 1) % TONE_MAPS.length] });
    else if (key === '+' || key === '=') view.zoomButton('in');
    else if (key === '-') view.zoomButton('out');
    else if (key === '0') view.fit();
    else if (key === '9') view.zoomTo(1);
    else if (key === 'c') comparison.say(view.markCorner());
    else if (key === 'escape' && state.pixel) view.letGo();
    else if (key === '?') this.help.showModal();
    else return false;
    return true;
  }

  nextLayer(step) {
    const names = [...this.fields.layer.options].map((option) => option.value);
    const next = names[(names.indexOf(this.state.layer) + step + names.length) % names.length];
    this.comparison.change({ layer: next, lo: null, hi: null });
    this.comparison.say(`Layer ${next}`);
  }
}

function row(title, value) {
  const box = document.createElement('div');
  box.append(element('dt', title), element('dd', value));
  return box;
}
