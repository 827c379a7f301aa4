// The page that compares pictures: what is loaded, drawn and said for the state in the address.
import { notice, element } from './problem.js';
import { announce } from './live.js';
import { Source, bitmap, compare, isCounted } from './compare-source.js';
import { GlRenderer, colorTable } from './compare-gl.js';
import { PlainRenderer } from './compare-plain.js';
import { addressOf, readState } from './compare-state.js';
import { View } from './compare-view.js';
import { Controls } from './compare-controls.js';
import { Values } from './compare-values.js';

export function startCompare() {
  startList();
  const root = document.querySelector('[data-compare]');
  if (root) new Comparison(root).start();
}

// Removing a picture works without anything else.
function startList() {
  const items = () => [...document.querySelectorAll('[data-picture]')];
  document.addEventListener('click', (event) => {
    const button = event.target.closest('[data-remove]');
    if (!button) return;
    const removed = button.closest('[data-picture]');
    const query = new URLSearchParams();
    for (const item of items()) if (item !== removed) query.append('p', item.dataset.spec);
    location.assign(`/compare?${query}`);
  });
}

class Comparison {
  constructor(root) {
    this.root = root;
    this.sources = [...document.querySelectorAll('[data-picture]')].map((item) => new Source(item));
    this.state = readState(this.sources.length);
    this.stage = root.querySelector('.stage');
    this.labels = root.querySelector('.stage-labels');
    this.busy = root.querySelector('[data-busy]');
    this.scaleBar = root.querySelector('.scale-bar');
    this.problems = new Map();
    this.loading = new Map();
    this.figures = null;
  }

  async start() {
    const canvas = this.stage.querySelector('canvas');
    this.canvas = canvas;
    this.renderer = this.makeRenderer();
    this.view = new View(this);
    this.controls = new Controls(this);
    this.values = new Values(this);
    await Promise.all(this.sources.map((source) => source.open().catch((problem) => this.fail(source, problem))));
    const found = this.sources.filter((source) => source.width > 0);
    this.width = Math.max(1, ...found.map((source) => source.width));
    this.height = Math.max(1, ...found.map((source) => source.height));
    this.controls.offerLayers(this.layerNames());
    if (this.state.crop && this.state.zoom === null) this.view.showCrop();
    this.update();
    new ResizeObserver(() => this.draw()).observe(this.stage);
    setInterval(() => this.tick(), 100);
    this.root.dataset.ready = '';
  }

  // WebGL2, or what a browser without it can show.
  makeRenderer() {
    const message = this.root.querySelector('[data-fallback]');
    if (!this.state.plain) {
      try {
        const renderer = new GlRenderer(this.canvas);
        renderer.onRestored = () => this.update();
        return renderer;
      } catch {
        // A canvas that was asked for WebGL gives nothing else.
        const fresh = this.canvas.cloneNode();
        this.canvas.replaceWith(fresh);
        this.canvas = fresh;
        this.state.plain = true;
      }
    }
    message.textContent = 'These are the PNG files as they were rendered: exposure, tone maps and layers need WebGL2, which '
      + 'this browser does not offer here.';
    message.hidden = false;
    return new PlainRenderer(this.canvas);
  }

  layerNames() {
    const names = new Set();
    for (const source of this.sources) for (const layer of source.layers) names.add(layer.name);
    if (this.state.plain || names.size === 0) return ['color'];
    return [...names];
  }

  // The layer that is shown, as the first picture that has it describes it.
  layer() {
    for (const source of [this.sources[this.state.ref], ...this.sources]) {
      const layer = source.layer(this.state.layer);
      if (layer) return layer;
    }
    return { name: this.state.layer, kind: 'color', non_finite: 0 };
  }

  // Range of the shown layer over all pictures, unless the state names one.
  range() {
    const layers = this.sources.map((source) => source.layer(this.state.layer)).filter(Boolean);
    const known = (values) => values.filter((value) => value !== null && value !== undefined);
    const low = Math.min(...known(layers.map((layer) => layer.minimum)));
    const high = Math.max(...known(layers.map((layer) => layer.maximum)));
    const [from, to] = Number.isFinite(low) ? [low, high > low ? high : low + 1] : [0, 1];
    return [this.state.lo ?? from, this.state.hi ?? to];
  }

  change(changes) {
    const before = this.state;
    this.state = { ...before, ...changes };
    this.update();
  }

  update() {
    const { state } = this;
    this.controls.show();
    this.loadWanted();
    this.values.show();
    this.compareSoon();
    this.draw();
    clearTimeout(this.addressTimer);
    const specs = this.sources.map((source) => source.spec);
    this.addressTimer = setTimeout(() => history.replaceState(null, '', addressOf(state, specs)), 150);
  }

  keyOf(source) {
    return `${source.hash} ${this.state.layer}`;
  }

  // Without the scale bar of a file: the page has one of its own.
  heatKey() {
    return this.figures && `${this.figures.heat_map}&scale=false`;
  }

  // The service draws the difference for browsers that cannot.
  differenceKey() {
    return this.figures && this.state.plain ? `${this.figures.difference}&gain=${this.state.gain}` : undefined;
  }

  // Reads what the state needs and is not there.
  loadWanted() {
    const wanted = new Set(this.sources.map((source) => this.keyOf(source)));
    const made = { heat: this.heatKey(), difference: this.differenceKey() }[this.state.mode];
    if (this.heatKey()) wanted.add(this.heatKey());
    if (made) wanted.add(made);
    this.renderer.keepOnly(wanted);
    for (const source of this.sources) {
      if (!source.width || this.problems.has(source)) continue;
      const read = this.state.plain
        ? () => (source.png ? bitmap(source.png).then((image) => ({ image, ...source })) : noPng())
        : () => source.read(this.state.layer);
      this.load(this.keyOf(source), read, (problem) => this.fail(source, problem));
    }
    if (made) {
      const { width, height } = this.figures;
      const read = async () => ({ image: await bitmap(made), encoded: true, width, height, kind: 0 });
      this.load(made, read, (problem) => this.showProblem(problem));
    }
    this.busy.hidden = this.loading.size === 0;
  }

  load(key, read, fail) {
    if (this.renderer.has(key) || this.loading.has(key)) return;
    this.loading.set(key, true);
    const done = () => {
      this.loading.delete(key);
      this.busy.hidden = this.loading.size === 0;
      this.draw();
    };
    read()
      .then((pixels) => {
        if (!pixels) return;
        if (Math.max(pixels.width, pixels.height) > this.renderer.limit) {
          throw { title: 'Too large', detail: `This device shows pictures of up to ${this.renderer.limit} pixels.`, errors: [] };
        }
        this.renderer.put(key, pixels);
      })
      .catch(fail)
      .finally(done);
  }

  fail(source, problem) {
    this.problems.set(source, problem);
    this.showProblem({ ...problem, title: `${source.title}: ${problem.title ?? 'not readable'}`, errors: problem.errors ?? [] });
    this.draw();
  }

  showProblem(problem) {
    document.getElementById('alerts').append(notice({ ...problem, errors: problem.errors ?? [] }));
  }

  // Asks for the figures of the pair, once the state has settled.
  compareSoon() {
    const [a, b] = [this.sources[this.state.ref], this.sources[this.state.other]];
    const key = [a.hash, b.hash, this.state.layer, this.state.ev].join(' ');
    if (key === this.comparedKey) return;
    this.comparedKey = key;
    this.figures = null;
    this.controls.showFigures(null, null);
    clearTimeout(this.compareTimer);
    this.compareTimer = setTimeout(async () => {
      const [found, problem] = await compare(a, b, this.state.layer, this.state.ev).then(
        (found) => [found, null],
        (problem) => [null, problem],
      );
      if (key !== this.comparedKey) return;
      this.figures = found;
      this.controls.showFigures(found, problem);
      this.loadWanted();
      this.draw();
    }, 300);
  }

  // The panes of the view: which picture is where. In device pixels.
  panes() {
    const { state, sources, canvas } = this;
    const whole = { left: 0, top: 0, width: canvas.width, height: canvas.height };
    const picture = (index, place) => ({ ...place, key: this.keyOf(sources[index]), index, displayed: sources[index].displayed || state.layer !== 'color' });
    const [a, b] = [state.ref, state.other];
    switch (state.mode) {
      case 'swipe': {
        const edge = Math.round(state.at * canvas.width);
        return [
          picture(a, { ...whole, clipLeft: 0, clipWidth: edge }),
          picture(b, { ...whole, clipLeft: edge, clipWidth: canvas.width - edge }),
        ];
      }
      case 'flicker':
        return [picture(state.flipped ? b : a, whole)];
      case 'difference':
        if (state.plain) return [{ ...whole, key: this.differenceKey(), second: this.differenceKey() }];
        return [{ ...picture(a, whole), second: this.keyOf(sources[b]) }];
      case 'heat':
        return [{ ...whole, key: this.heatKey(), encoded: true }];
      default: {
        const wide = canvas.width > canvas.height * 0.9;
        const columns = wide ? Math.ceil(Math.sqrt(sources.length * (sources.length > 3 ? 1 : 4))) : sources.length > 3 ? 2 : 1;
        const across = Math.min(columns, sources.length);
        const down = Math.ceil(sources.length / across);
        const [width, height] = [Math.floor(canvas.width / across), Math.floor(canvas.height / down)];
        return sources.map((_, i) => picture(i, { left: (i % across) * width, top: Math.floor(i / across) * height, width: width - 1, height: height - 1 }));
      }
    }
  }

  draw() {
    if (this.frame || !this.width) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      const { canvas, state } = this;
      const ratio = devicePixelRatio;
      const [width, height] = [Math.round(this.stage.clientWidth * ratio), Math.round(this.stage.clientHeight * ratio)];
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      const layer = this.layer();
      const panes = this.panes();
      const { zoom, center } = this.view.current(panes[0]);
      const settings = { zoom, center, ev: state.ev, tm: state.tm, map: state.map, gain: state.gain, range: this.range(), counted: isCounted(layer) };
      this.renderer.draw(panes, settings);
      this.drawLabels(panes, ratio);
      this.view.drawMarks(panes, ratio);
      this.controls.showScale(zoom);
      this.drawScaleBar(layer);
      canvas.setAttribute('aria-label', this.describe(panes));
    });
  }

  describe(panes) {
    const name = (pane) => (pane.index === undefined ? '' : this.sources[pane.index].title);
    const [a, b] = [this.sources[this.state.ref].title, this.sources[this.state.other].title];
    if (this.state.mode === 'difference') return `Absolute difference of ${a} and ${b}, layer ${this.state.layer}`;
    if (this.state.mode === 'heat') return `FLIP error of ${b} against ${a}, layer ${this.state.layer}`;
    return `${panes.map(name).join(' beside ')}, layer ${this.state.layer}`;
  }

  drawLabels(panes, ratio) {
    const letter = (index) => String.fromCharCode(65 + index);
    const labels = panes.map((pane) => {
      const label = element('span', '');
      const left = (pane.clipLeft ?? pane.left) / ratio;
      label.className = 'stage-label';
      if (this.state.mode === 'swipe' && pane.clipLeft > 0) label.classList.add('right');
      else label.style.left = `${left + 8}px`;
      label.style.top = `${pane.top / ratio + 8}px`;
      if (pane.second) label.textContent = `| ${letter(this.state.other)} − ${letter(this.state.ref)} |`;
      else if (pane.index === undefined) label.textContent = this.figures ? `FLIP ${letter(this.state.other)} against ${letter(this.state.ref)}` : 'The heat map is being made…';
      else label.textContent = `${letter(pane.index)} ${this.sources[pane.index].title}${this.missing(pane) || ` · ${this.sources[pane.index].about}`}`;
      return label;
    });
    this.labels.replaceChildren(...labels);
  }

  missing(pane) {
    const source = this.sources[pane.index];
    if (this.problems.has(source)) return ': cannot be shown';
    return source.width && !this.state.plain && !source.layer(this.state.layer) ? `: has no layer ${this.state.layer}` : '';
  }

  // What the false colours mean.
  drawScaleBar(layer) {
    const { state, scaleBar } = this;
    const isHeat = state.mode === 'heat';
    const isScale = layer.kind === 'scalar' || isCounted(layer);
    scaleBar.hidden = !(isHeat || isScale) || state.plain && !isHeat;
    if (scaleBar.hidden) return;
    const [low, high] = isHeat ? [0, 1] : state.mode === 'difference' ? [0, (this.range()[1] - this.range()[0]) / state.gain] : this.range();
    const isWhole = !isHeat && layer.kind === 'integer' && Number.isInteger(low) && Number.isInteger(high);
    const short = (value) => String(isWhole ? value : Number(value.toPrecision(4)));
    scaleBar.querySelector('[data-low]').textContent = short(low);
    scaleBar.querySelector('[data-high]').textContent = short(high);
    scaleBar.querySelector('[data-what]').textContent = isHeat ? 'FLIP error' : state.mode === 'difference' ? `${layer.name} difference` : layer.name;
    const table = colorTable(isHeat ? 'magma' : state.map);
    scaleBar.querySelector('canvas').getContext('2d').putImageData(new ImageData(table, 256, 1), 0, 0);
  }

  // Flicker in play.
  tick() {
    const { state } = this;
    if (state.mode !== 'flicker' || !state.play || document.hidden) return;
    const now = performance.now();
    if (now - (this.flippedAt ?? 0) < state.every * 1000) return;
    this.flippedAt = now;
    this.state.flipped = !state.flipped;
    this.draw();
  }

  say(text) {
    announce(text);
  }
}

async function noPng() {
  throw { title: 'no PNG', detail: 'Without WebGL2 only PNG files can be shown.', errors: [] };
}
