// Draws pictures without WebGL2: the PNG files as they were rendered, moved and zoomed by a 2D canvas.
import { originOf } from './compare-state.js';

export class PlainRenderer {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d', { alpha: false });
    this.images = new Map();
    this.limit = Infinity;
  }

  put(key, pixels) {
    this.images.set(key, pixels.image);
  }

  has(key) {
    return this.images.has(key);
  }

  keepOnly(keys) {
    for (const key of this.images.keys()) if (!keys.has(key)) this.images.delete(key);
  }

  // As GlRenderer.draw, without exposure, tone maps and layers.
  draw(panes, view) {
    const { context, canvas } = this;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = '#17181c';
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.imageSmoothingEnabled = view.zoom < 1;
    for (const pane of panes) {
      const image = this.images.get(pane.key);
      if (!image) continue;
      context.save();
      context.beginPath();
      context.rect(pane.clipLeft ?? pane.left, pane.top, pane.clipWidth ?? pane.width, pane.height);
      context.clip();
      const [left, top] = originOf(pane, view);
      context.drawImage(image, pane.left + left, pane.top + top, image.width * view.zoom, image.height * view.zoom);
      context.restore();
    }
  }
}
