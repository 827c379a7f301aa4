// The log of a job: read again after each refresh, and kept at its end while "follow" is on.
import { onRefresh } from './live.js';

export function startLog() {
  const log = document.getElementById('log');
  if (!log) return;
  const follow = document.getElementById('follow');
  let tag = null;
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
  onRefresh(load);
  follow.addEventListener('change', load);
  load();
}
