// Keys that work on every page: G and a letter goes to a page, N begins a job, / searches, ? lists them.

const WITHIN_MS = 1500;

export function startKeys() {
  const help = document.getElementById('keys');
  const places = new Map([...help.querySelectorAll('[data-go]')].map((row) => [row.dataset.go, row.dataset.to]));
  let wentAt = -Infinity;
  document.querySelector('[data-show-keys]').addEventListener('click', () => help.showModal());
  // Before the keys of single pages: after G, a letter means a place.
  document.addEventListener('keydown', (event) => {
    const isTyping = event.target.closest('input:not([type=radio], [type=checkbox], [type=range]), select, textarea, dialog[open]');
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    const isPlace = performance.now() - wentAt < WITHIN_MS;
    wentAt = event.key === 'g' && !isPlace ? performance.now() : -Infinity;
    if (isPlace && places.has(event.key)) location.assign(places.get(event.key));
    else if (event.key === 'n') location.assign('/jobs/new');
    else if (event.key === '/' && search()) search().focus();
    // A page with more keys has a list of its own.
    else if (event.key === '?' && !document.getElementById('shortcuts')) help.showModal();
    else if (event.key !== 'g') return;
    event.preventDefault();
    event.stopImmediatePropagation();
  }, true);
}

const search = () => document.querySelector('main [role=search] input:not([type=hidden])');
