// Zoom of a job's picture.

export function startViewer() {
  const viewer = document.querySelector('[data-viewer]');
  if (!viewer) return;
  const viewport = viewer.querySelector('.viewport');
  const box = document.getElementById('picture-box');

  const apply = () => {
    const zoom = viewer.querySelector('[name=zoom]:checked').value;
    const sharp = viewer.querySelector('[name=pixelated]').checked;
    const middle = middleOf(viewport);
    box.classList.toggle('zoomed', zoom !== 'fit');
    box.classList.toggle('sharp', sharp);
    const picture = box.querySelector('img, svg');
    const width = Number(picture?.getAttribute('width'));
    if (picture) picture.style.width = zoom === 'fit' ? '' : `${(width * Number(zoom)) / devicePixelRatio}px`;
    viewport.scrollLeft = middle.x * viewport.scrollWidth - viewport.clientWidth / 2;
    viewport.scrollTop = middle.y * viewport.scrollHeight - viewport.clientHeight / 2;
  };
  viewer.addEventListener('change', apply);
  // A refresh may bring another picture element.
  new MutationObserver(apply).observe(box, { childList: true });
  apply();
}

// What is in the middle of the view, as a share of the whole: it stays there when the zoom changes.
function middleOf(viewport) {
  return {
    x: (viewport.scrollLeft + viewport.clientWidth / 2) / viewport.scrollWidth,
    y: (viewport.scrollTop + viewport.clientHeight / 2) / viewport.scrollHeight,
  };
}
