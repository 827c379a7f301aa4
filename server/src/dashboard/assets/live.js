// Keeps a page current. The event stream says that something changed; the page itself, fetched again, says what. Regions
// marked `data-live` are patched by id. Where the stream fails, and for what has no events, the page also polls.
import { morph } from './morph.js';
import { retryMissing } from './images.js';

const EVENTS = [
  'job.created', 'job.changed', 'job.started', 'job.progress', 'job.preview', 'job.succeeded', 'job.failed',
  'job.cancelled', 'job.retried', 'job.deleted', 'task.leased', 'task.succeeded', 'task.failed', 'task.retried', 'task.expired',
  'task.cancelled',
];
// At most this often, however many events come.
const QUIET_MS = 500;

const listeners = new Set();
let stream = null;
let timer = null;
let busy = false;
let again = false;

// Calls `listener` after each refresh.
export function onRefresh(listener) {
  listeners.add(listener);
}

export function startLive() {
  if (!document.querySelector('[data-live]')) return;
  listen();
  schedulePoll();
  document.addEventListener('visibilitychange', () => {
    if (!document.hidden) refreshSoon();
  });
  // A page that the browser keeps while one is elsewhere must not hold a connection, and is old when one comes back.
  addEventListener('pagehide', () => {
    stream?.close();
    stream = null;
  });
  addEventListener('pageshow', (event) => {
    if (!event.persisted) return;
    listen();
    refreshSoon();
  });
}

function listen() {
  const address = document.body.dataset.events;
  if (!address) {
    stream?.close();
    stream = null;
    return;
  }
  if (stream) return;
  stream = new EventSource(address);
  for (const name of EVENTS) stream.addEventListener(name, refreshSoon);
  stream.addEventListener('message', refreshSoon);
  stream.addEventListener('error', () => {
    if (stream?.readyState === EventSource.CLOSED) stream = null; // the next refresh opens another
  });
}

function schedulePoll() {
  const period = Number(document.body.dataset.poll);
  if (period > 0) {
    setTimeout(() => {
      refreshSoon();
      schedulePoll();
    }, period);
  }
}

export function refreshSoon() {
  if (document.hidden) return;
  timer ??= setTimeout(() => {
    timer = null;
    refresh();
  }, QUIET_MS);
}

export async function refresh() {
  if (busy) {
    again = true;
    return;
  }
  busy = true;
  try {
    const response = await fetch(location.href, { headers: { Accept: 'text/html' } });
    if (!response.ok) return;
    patch(new DOMParser().parseFromString(await response.text(), 'text/html'));
    for (const listener of listeners) listener();
  } catch {
    // The service is away for a moment: the next event or poll tries again.
  } finally {
    busy = false;
    if (again) {
      again = false;
      refreshSoon();
    }
  }
}

function patch(fresh) {
  const before = spokenState();
  for (const region of document.querySelectorAll('[data-live]')) {
    const replacement = fresh.getElementById(region.id);
    if (replacement) morph(region, replacement);
    retryMissing(region);
  }
  document.title = fresh.title;
  for (const name of ['events', 'poll']) {
    if (name in fresh.body.dataset) document.body.dataset[name] = fresh.body.dataset[name];
    else delete document.body.dataset[name];
  }
  listen();
  const after = spokenState();
  if (after !== before) announce(after);
}

// What a screen reader is told of a job: its state, and every quarter of its progress.
function spokenState() {
  const state = document.getElementById('state')?.textContent.trim() ?? '';
  const progress = document.querySelector('#progress progress');
  const quarter = progress ? Math.floor(progress.value * 4) * 25 : 0;
  return state && (quarter ? `${state}, ${quarter} percent` : state);
}

// Tells a screen reader, without moving the focus.
export function announce(text) {
  document.getElementById('announcer').textContent = text;
}
