// The log of a job: read again after each refresh, and kept at its end while "follow" is on.
import { onRefresh } from './live.js';

// A worker's last lines may come after the job's end: a cancelled one is over before its worker knows.
const LATE_LINES_MS = [1500, 6000, 20000];

export function startLog() {
  const log = document.getElementById('log');
  if (!log) return;
  const follow = document.getElementById('follow');
  let tag = null;
  let isOver = !document.body.dataset.events;
  const load = async () => {
    try {
      const response = await fetch(log.dataset.log, { headers: tag ? { 'If-None-Match': tag } : {} });
      if (response.status === 304) return;
      const text = response.ok ? await response.text() : '';
      tag = response.headers.get('ETag');
      const shown = text.trim() ? text : 'Nothing has been logged yet.';
      if (shown !== log.textContent) log.textContent = shown;
      if (follow.checked) log.scrollTop = log.scrollHeight;
    } catch {
      // The next refresh tries again.
    }
  };
  onRefresh(() => {
    load();
    const wasOver = isOver;
    isOver = !document.body.dataset.events;
    if (isOver && !wasOver) for (const delay of LATE_LINES_MS) setTimeout(load, delay);
  });
  follow.addEventListener('change', load);
  load();
}
