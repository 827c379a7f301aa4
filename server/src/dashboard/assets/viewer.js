// Zoom of a job's picture.

export function startViewer() {
  const viewer = document.querySelector('[data-viewer]');
  if (!viewer) return;
  const box = document.getElementById('picture-box');
  const apply = () => {
    const zoom = viewer.querySelector('[name=zoom]:checked').value;
    const sharp = viewer.querySelector('[name=pixelated]').checked;
    box.classList.toggle('zoomed', zoom !== 'fit');
    box.classList.toggle('sharp', sharp);
    const picture = box.querySelector('img, svg');
    const width = Number(picture?.getAttribute('width'));
    if (picture) picture.style.width = zoom === 'fit' ? '' : `${(width * Number(zoom)) / devicePixelRatio}px`;
  };
  viewer.addEventListener('change', apply);
  // A refresh may bring another element, or take our classes away.
  new MutationObserver(apply).observe(box, { childList: true });
  apply();
}
