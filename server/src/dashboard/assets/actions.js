// Buttons that make one request (cancel, pause, retry, drain, delete), and buttons that copy.
import { notice, request } from './problem.js';
import { refresh } from './live.js';

export function startActions() {
  document.addEventListener('submit', (event) => {
    const form = event.target;
    if (!form.dataset.action) return;
    event.preventDefault();
    perform(form);
  });
  document.addEventListener('click', (event) => {
    const button = event.target.closest('[data-copy]');
    if (button) copy(button);
  });
}

async function perform(form) {
  const { action, method, body, then, confirm: question } = form.dataset;
  if (question && !confirm(question)) return;
  const button = form.querySelector('button');
  const alerts = document.getElementById('alerts');
  button.disabled = true;
  try {
    const headers = body ? { 'Content-Type': 'application/json' } : {};
    await request(action, { method, headers, body });
    alerts.replaceChildren();
    if (then) location.assign(then);
    else await refresh();
  } catch (problem) {
    alerts.replaceChildren(notice(problem));
  } finally {
    button.disabled = false;
  }
}

async function copy(button) {
  const source = document.getElementById(button.dataset.copy);
  try {
    await navigator.clipboard.writeText(source.textContent);
  } catch {
    // Without a secure context there is no clipboard: select the text instead.
    getSelection().selectAllChildren(source);
    return;
  }
  const before = button.textContent;
  button.textContent = 'Copied';
  setTimeout(() => (button.textContent = before), 1500);
}
