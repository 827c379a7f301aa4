// Buttons that make one request (cancel, pause, retry, priority, drain, delete), and buttons that copy.
import { notice, request } from './problem.js';
import { announce, refresh } from './live.js';

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
  const { action, method, then, done, confirm: question } = form.dataset;
  // Not `disabled`, which would take the focus away from whoever works with the keyboard.
  if (form.ariaBusy === 'true' || (question && !confirm(question))) return;
  const alerts = document.getElementById('alerts');
  const body = bodyOf(form);
  form.ariaBusy = 'true';
  try {
    const headers = body ? { 'Content-Type': 'application/json' } : {};
    await request(action, { method, headers, body });
    alerts.replaceChildren();
    if (then) {
      location.assign(then);
      return;
    }
    await refresh();
    form.reset();
    if (done) announce(done);
  } catch (problem) {
    alerts.replaceChildren(notice(problem));
    alerts.scrollIntoView({ block: 'nearest' });
  } finally {
    form.ariaBusy = null;
  }
}

// What the form says to send, or else its numbers by name.
function bodyOf(form) {
  if (form.dataset.body) return form.dataset.body;
  const numbers = [...form.querySelectorAll('input[type=number]')].map((input) => [input.name, input.valueAsNumber]);
  return numbers.length > 0 ? JSON.stringify(Object.fromEntries(numbers)) : undefined;
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
  announce('Copied.');
  setTimeout(() => (button.textContent = before), 1500);
}
