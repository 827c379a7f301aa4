// Charts as files: SVG with the colours that it has here, or PNG; tables as CSV.

// Properties that style sheets give and a file of its own needs.
const STYLES = ['fill', 'stroke', 'stroke-width', 'font-size', 'font-family', 'font-weight'];
// Pixels of a PNG for each unit of the drawing.
const SCALE = 3;

export function startCharts() {
  document.addEventListener('click', (event) => {
    const button = event.target.closest('[data-export]');
    if (button?.dataset.export === 'csv') saveTable(button.closest('section').querySelector('table'));
    else if (button) save(button.closest('figure').querySelector('svg'), button.dataset.export);
  });
}

async function save(svg, form) {
  const name = nameOf((svg.getAttribute('aria-label') ?? 'chart').split(':')[0]);
  const text = new Blob([serialize(svg)], { type: 'image/svg+xml' });
  download(form === 'png' ? await toPng(text, svg.viewBox.baseVal) : text, `${name}.${form}`);
}

// As RFC 4180 has it.
function saveTable(table) {
  const quoted = (cell) => `"${cell.textContent.trim().replaceAll('"', '""')}"`;
  const text = [...table.rows].map((row) => `${[...row.cells].map(quoted).join(',')}\r\n`).join('');
  download(new Blob([text], { type: 'text/csv' }), `${nameOf(table.caption.textContent)}.csv`);
}

const nameOf = (title) => title.trim().toLowerCase().replaceAll(/[^a-z0-9]+/g, '-');

function serialize(svg) {
  const copy = svg.cloneNode(true);
  const originals = [svg, ...svg.querySelectorAll('*')];
  [copy, ...copy.querySelectorAll('*')].forEach((element, i) => {
    const style = getComputedStyle(originals[i]);
    for (const name of STYLES) element.setAttribute(name, style.getPropertyValue(name));
    element.removeAttribute('class');
  });
  const { width, height } = svg.viewBox.baseVal;
  const paper = document.createElementNS(svg.namespaceURI, 'rect');
  const background = getComputedStyle(svg.closest('.panel') ?? document.body).backgroundColor;
  for (const [key, value] of Object.entries({ width, height, fill: background })) paper.setAttribute(key, value);
  copy.prepend(paper);
  copy.setAttribute('width', width);
  copy.setAttribute('height', height);
  return new XMLSerializer().serializeToString(copy);
}

async function toPng(text, { width, height }) {
  const address = URL.createObjectURL(text);
  try {
    const image = new Image();
    image.src = address;
    await image.decode();
    const canvas = Object.assign(document.createElement('canvas'), { width: width * SCALE, height: height * SCALE });
    canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
    return await new Promise((done) => canvas.toBlob(done, 'image/png'));
  } finally {
    URL.revokeObjectURL(address);
  }
}

function download(blob, name) {
  const link = Object.assign(document.createElement('a'), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
