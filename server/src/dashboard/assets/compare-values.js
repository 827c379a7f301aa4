// The table of values: every layer of every picture at one pixel.
import { element } from './problem.js';

// The pointer rests this long before the service is asked.
const REST_MS = 60;

export class Values {
  constructor(comparison) {
    this.comparison = comparison;
    const { root } = comparison;
    this.head = root.querySelector('.values thead');
    this.body = root.querySelector('.values tbody');
    this.place = root.querySelector('[data-place]');
    this.hint = root.querySelector('[data-values-hint]');
    this.box = root.querySelector('[data-values]');
  }

  show() {
    const pixel = this.comparison.view.pixel();
    if (!pixel) return;
    const key = pixel.join(',');
    if (key === this.shown) return;
    this.wanted = pixel;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.ask(), REST_MS);
  }

  // One question at a time: what was passed over meanwhile is not asked for.
  async ask() {
    if (this.asking) return;
    this.asking = true;
    while (this.wanted) {
      const pixel = this.wanted;
      this.wanted = null;
      const { sources } = this.comparison;
      const columns = await Promise.all(sources.map((source) => source.valuesAt(...pixel).catch(() => null)));
      this.fill(pixel, columns);
    }
    this.asking = false;
  }

  fill(pixel, columns) {
    this.shown = pixel.join(',');
    const outside = columns.every((column) => column === null);
    this.place.textContent = `at ${pixel.join(', ')}${this.comparison.state.pixel ? ', held' : ''}`;
    this.hint.hidden = !outside;
    this.box.hidden = outside;
    this.hint.textContent = outside ? 'Outside of the pictures.' : '';
    const names = new Set(columns.flatMap((column) => (column ?? []).map((layer) => layer.name)));
    const head = document.createElement('tr');
    head.append(cell('th', 'Layer', 'col'), ...columns.map((_, i) => cell('th', String.fromCharCode(65 + i), 'col')));
    this.head.replaceChildren(head);
    const rows = [...names].map((name) => {
      const row = document.createElement('tr');
      row.append(cell('th', name, 'row'));
      const texts = columns.map((column) => text((column ?? []).find((layer) => layer.name === name)));
      const differs = new Set(texts).size > 1;
      row.append(...texts.map((value) => cell('td', value)));
      if (differs) row.className = 'differs';
      return row;
    });
    this.body.replaceChildren(...rows);
  }
}

function cell(name, content, scope) {
  const made = element(name, content);
  if (scope) made.scope = scope;
  return made;
}

function text(layer) {
  if (!layer) return '·';
  const number = (value) => (value === null ? 'none' : Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(5))));
  return layer.values.map(number).join('  ');
}
