// Pictures that may not exist yet, such as the thumbnail of a scene that was just uploaded: hidden until they load, and
// tried again whenever the page refreshes them.

export function hideMissingImages() {
  // `error` and `load` do not bubble, but can be captured.
  document.addEventListener('error', (event) => mark(event.target, true), true);
  document.addEventListener('load', (event) => mark(event.target, false), true);
  for (const image of document.querySelectorAll('img[data-optional]')) {
    if (image.complete && image.naturalWidth === 0 && image.loading !== 'lazy') mark(image, true);
  }
}

function mark(image, missing) {
  if (image instanceof HTMLImageElement && image.hasAttribute('data-optional')) {
    image.classList.toggle('missing', missing);
  }
}

// Shows `source` in `image` once it is there, so that the old picture stays until then.
export function swap(image, source) {
  if (image.getAttribute('data-next') === source) return;
  image.setAttribute('data-next', source);
  const next = new Image();
  next.src = source;
  next.decode().then(
    () => {
      if (image.getAttribute('data-next') === source) image.src = source;
    },
    () => {
      if (image.getAttribute('data-next') === source) image.removeAttribute('data-next');
    },
  );
}

// Tries the hidden ones again.
export function retryMissing(root) {
  for (const image of root.querySelectorAll('img.missing')) swap(image, image.getAttribute('src'));
}
