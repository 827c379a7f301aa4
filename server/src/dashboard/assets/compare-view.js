// Where one looks: zoom and place, moved by mouse, touch and keys; the held pixel and the marked part.
import { originOf } from './compare-state.js';

const STEP = Math.SQRT2;
const LEAST = 0.02;
const MOST = 64;
// A press that moves less than this is a click. In CSS pixels.
const CLICK_PX = 4;
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export class View {
  constructor(comparison) {
    this.comparison = comparison;
    this.stage = comparison.stage;
    this.marks = document.createElement('div');
    this.marks.className = 'stage-marks';
    this.stage.append(this.marks);
    this.pointers = new Map();
    this.hover = null;
    // Where a part that is marked from the keyboard begins.
    this.corner = null;
    this.listen();
  }

  get state() {
    return this.comparison.state;
  }

  // Zoom and centre for panes of this size, in device pixels.
  current(pane) {
    const { width, height } = this.comparison;
    const fit = Math.min((pane?.width ?? 1) / width, (pane?.height ?? 1) / height);
    const zoom = this.state.zoom ?? clamp(fit, LEAST, MOST);
    const center = this.state.zoom === null || !this.state.center ? [width / 2, height / 2] : this.state.center;
    return { zoom, center };
  }

  // The pane below a place of the stage, and the place in it; in device pixels.
  locate(event) {
    const box = this.stage.getBoundingClientRect();
    const ratio = devicePixelRatio;
    const x = (event.clientX - box.left - this.stage.clientLeft) * ratio;
    const y = (event.clientY - box.top - this.stage.clientTop) * ratio;
    const panes = this.comparison.panes();
    const inside = (pane) => x >= pane.left && y >= pane.top && x < pane.left + pane.width + 1 && y < pane.top + pane.height + 1;
    const pane = panes.find(inside) ?? panes[0];
    return { pane, x: x - pane.left - pane.width / 2, y: y - pane.top - pane.height / 2, stageX: x };
  }

  // The place in the picture, in its pixels.
  toPicture({ pane, x, y }) {
    const view = this.current(pane);
    const origin = originOf(pane, view);
    return [(x + pane.width / 2 - origin[0]) / view.zoom, (y + pane.height / 2 - origin[1]) / view.zoom];
  }

  zoomTo(zoom, anchor) {
    const panes = this.comparison.panes();
    const now = this.current(panes[0]);
    const next = clamp(zoom, LEAST, MOST);
    const at = anchor ? this.toPicture(anchor) : now.center;
    const [dx, dy] = anchor ? [anchor.x, anchor.y] : [0, 0];
    this.place(next, [at[0] - dx / next, at[1] - dy / next]);
  }

  zoomBy(factor, anchor) {
    this.zoomTo(this.current(this.comparison.panes()[0]).zoom * factor, anchor);
  }

  place(zoom, center) {
    const { width, height } = this.comparison;
    this.comparison.change({ zoom, center: [clamp(center[0], 0, width), clamp(center[1], 0, height)] });
  }

  // By a share of the view.
  moveBy(x, y) {
    const pane = this.comparison.panes()[0];
    const { zoom, center } = this.current(pane);
    this.place(zoom, [center[0] + (x * pane.width) / zoom, center[1] + (y * pane.height) / zoom]);
  }

  fit() {
    this.comparison.change({ zoom: null, center: null });
  }

  zoomButton(what) {
    if (what === 'fit') this.fit();
    else if (what === 'one') this.zoomTo(1);
    else this.zoomBy(what === 'in' ? STEP : 1 / STEP);
  }

  showCrop() {
    const [x, y, width, height] = this.state.crop;
    const pane = this.comparison.panes()[0];
    const zoom = Math.min((0.9 * pane.width) / Math.max(width, 1), (0.9 * pane.height) / Math.max(height, 1));
    this.place(clamp(zoom, LEAST, MOST), [x + width / 2, y + height / 2]);
  }

  // The pixel whose values are shown: the held one, or the one under the pointer.
  pixel() {
    return this.state.pixel ?? this.hover;
  }

  // To the next pixel, or as far as can be seen where pixels are smaller than the screen's.
  movePixel(dx, dy) {
    const { width, height } = this.comparison;
    const { zoom, center } = this.current(this.comparison.panes()[0]);
    const step = Math.max(1, Math.round(1 / zoom));
    const from = this.pixel() ?? center.map(Math.floor);
    const pixel = [clamp(from[0] + step * dx, 0, width - 1), clamp(from[1] + step * dy, 0, height - 1)];
    this.comparison.change({ pixel });
  }

  letGo() {
    this.corner = null;
    this.comparison.change({ pixel: null });
  }

  // Marks a part from the keyboard: from the pixel of one call to that of the next. Answers what there is to say.
  markCorner() {
    const pixel = this.pixel();
    if (!pixel) return 'Hold a pixel first: Shift and an arrow, or a click.';
    if (!this.corner) {
      this.corner = pixel;
      return `One corner is at ${pixel.join(', ')}. Go to the other one and press C again.`;
    }
    const low = [0, 1].map((axis) => Math.min(this.corner[axis], pixel[axis]));
    const high = [0, 1].map((axis) => Math.max(this.corner[axis], pixel[axis]) + 1);
    const crop = this.box(low, high);
    this.corner = null;
    this.comparison.change({ crop });
    return `Marked ${crop[2]} × ${crop[3]} pixels.`;
  }

  listen() {
    const { stage } = this;
    stage.addEventListener('wheel', (event) => {
      event.preventDefault();
      const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
      this.zoomBy(2 ** clamp((-event.deltaY * lines) / 240, -1, 1), this.locate(event));
    }, { passive: false });
    stage.addEventListener('pointerdown', (event) => this.press(event));
    stage.addEventListener('pointermove', (event) => this.move(event));
    for (const name of ['pointerup', 'pointercancel']) stage.addEventListener(name, (event) => this.release(event));
    stage.addEventListener('pointerleave', () => {
      this.hover = null;
    });
    stage.addEventListener('dblclick', (event) => {
      if (this.state.zoom === null) this.zoomTo(1, this.locate(event));
      else this.fit();
    });
  }

  press(event) {
    if (event.button !== 0) return;
    this.stage.setPointerCapture(event.pointerId);
    const at = this.locate(event);
    this.pointers.set(event.pointerId, at);
    this.pressed = { x: event.clientX, y: event.clientY, moved: false, marking: event.shiftKey ? this.toPicture(at) : null };
    const edge = this.state.at * this.comparison.canvas.width;
    this.pressed.dividing = this.state.mode === 'swipe' && Math.abs(at.stageX - edge) < 14 * devicePixelRatio;
  }

  move(event) {
    const at = this.locate(event);
    const before = this.pointers.get(event.pointerId);
    const place = this.toPicture(at).map(Math.floor);
    this.hover = place;
    if (before) this.drag(event, at, before);
    if (!this.state.pixel) this.comparison.values.show();
  }

  drag(event, at, before) {
    const { pressed } = this;
    pressed.moved ||= Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) > CLICK_PX;
    if (!pressed.moved) return;
    if (this.pointers.size === 2) {
      this.pinch(event.pointerId, at);
      return;
    }
    this.pointers.set(event.pointerId, at);
    if (pressed.dividing) {
      this.comparison.change({ at: clamp(at.stageX / this.comparison.canvas.width, 0, 1) });
    } else if (pressed.marking) {
      this.comparison.change({ crop: this.box(pressed.marking, this.toPicture(at)) });
    } else {
      const { zoom, center } = this.current(at.pane);
      const same = at.pane.left === before.pane.left && at.pane.top === before.pane.top;
      if (same) this.place(zoom, [center[0] - (at.x - before.x) / zoom, center[1] - (at.y - before.y) / zoom]);
    }
  }

  // Two fingers: what is between them stays there.
  pinch(moved, at) {
    const [[, first], [, second]] = [...this.pointers];
    const middle = { pane: at.pane, x: (first.x + second.x) / 2, y: (first.y + second.y) / 2 };
    const apart = Math.hypot(first.x - second.x, first.y - second.y);
    const held = this.toPicture(middle);
    const { zoom } = this.current(at.pane);
    this.pointers.set(moved, at);
    const [[, third], [, fourth]] = [...this.pointers];
    const now = { x: (third.x + fourth.x) / 2, y: (third.y + fourth.y) / 2 };
    const next = clamp((zoom * Math.hypot(third.x - fourth.x, third.y - fourth.y)) / Math.max(apart, 1), LEAST, MOST);
    this.place(next, [held[0] - now.x / next, held[1] - now.y / next]);
  }

  // Whole pixels between two corners, inside the picture: left, top, width, height.
  box(a, b) {
    const { width, height } = this.comparison;
    const left = clamp(Math.floor(Math.min(a[0], b[0])), 0, width - 1);
    const top = clamp(Math.floor(Math.min(a[1], b[1])), 0, height - 1);
    const right = clamp(Math.ceil(Math.max(a[0], b[0])), left + 1, width);
    const bottom = clamp(Math.ceil(Math.max(a[1], b[1])), top + 1, height);
    return [left, top, right - left, bottom - top];
  }

  release(event) {
    const known = this.pointers.delete(event.pointerId);
    if (!known || event.type === 'pointercancel' || this.pressed.moved || event.shiftKey) return;
    const [x, y] = this.toPicture(this.locate(event)).map(Math.floor);
    const { width, height } = this.comparison;
    if (x < 0 || y < 0 || x >= width || y >= height) return;
    const isHeld = this.state.pixel?.[0] === x && this.state.pixel?.[1] === y;
    this.comparison.change({ pixel: isHeld ? null : [x, y] });
  }

  // The held pixel and the marked part, in every pane; the divider.
  drawMarks(panes, ratio) {
    const marks = [];
    const add = (className, pane, [x, y, width, height]) => {
      const { zoom, center } = this.current(pane);
      const [originX, originY] = originOf(pane, { zoom, center });
      const left = pane.left + originX + x * zoom;
      const top = pane.top + originY + y * zoom;
      const mark = document.createElement('span');
      mark.className = className;
      const size = className === 'mark-pixel' ? Math.max(zoom, 9 * ratio) : 0;
      const shift = size ? (size - zoom) / 2 : 0;
      Object.assign(mark.style, {
        left: `${(left - shift) / ratio}px`,
        top: `${(top - shift) / ratio}px`,
        width: `${(size || width * zoom) / ratio}px`,
        height: `${(size || height * zoom) / ratio}px`,
      });
      marks.push(mark);
    };
    const places = this.state.mode === 'swipe' ? panes.slice(0, 1) : panes;
    for (const pane of places) {
      if (this.state.crop) add('mark-crop', pane, this.state.crop);
      if (this.state.pixel) add('mark-pixel', pane, [...this.state.pixel, 1, 1]);
    }
    if (this.state.mode === 'swipe') {
      const divider = document.createElement('span');
      divider.className = 'mark-divider';
      divider.style.left = `${(this.state.at * this.comparison.canvas.width) / ratio}px`;
      marks.push(divider);
    }
    this.marks.replaceChildren(...marks);
  }
}
