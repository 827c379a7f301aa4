// Buttons that make one request (cancel, pause, retry, priority, drain, delete), and buttons that copy.
import { notice, request } from './problem.js';
import { announce, refresh } from './live.js';

export function startActions() {
  document.addEventListener('submit', (event) => {
    const form = event.target;
    if (!form.dataset.action && !event.submitter?.dataset.action) return;
    event.preventDefault();
    perform(form, event.submitter);
  });
  document.addEventListener('click', (event) => {
    const button = event.target.closest('[data-copy]');
    if (button) copy(button);
    const all = event.target.closest('[data-check-all]');
    if (all) for (const box of waiting(all.dataset.checkAll)) box.checked = true;
  });
  for (const input of document.querySelectorAll('[data-remember]')) remember(input);
}

const waiting = (name) => document.querySelectorAll(`input[name="${name}"][data-waits]`);

// Keeps what was typed into a field for the next time, in this browser.
function remember(input) {
  const key = `field-${input.dataset.remember}`;
  try {
    input.value ||= localStorage.getItem(key) ?? '';
    input.defaultValue = input.value;
    input.addEventListener('change', () => {
      localStorage.setItem(key, input.value);
      input.defaultValue = input.value;
    });
  } catch {
    // Storage may be forbidden.
  }
}

async function perform(form, submitter) {
  const { method, then, done, confirm: question } = form.dataset;
  const action = submitter?.dataset.action ?? form.dataset.action;
  // Not `disabled`, which would take the focus away from whoever works with the keyboard.
  if (form.ariaBusy === 'true' || (question && !confirm(question))) return;
  const alerts = document.getElementById('alerts');
  const body = bodyOf(form);
  const { need } = form.dataset;
  if (need && JSON.parse(body)[need].length === 0) {
    alerts.replaceChildren(notice({ title: 'Nothing is chosen', detail: 'Choose at least one first.', errors: [] }));
    return;
  }
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

// What the form says to send; or its texts by name, and the checked values of its lists; or else its numbers by name.
function bodyOf(form) {
  if (form.dataset.body) return form.dataset.body;
  if ('json' in form.dataset) {
    const lists = (form.dataset.lists ?? '').split(' ').filter(Boolean);
    const data = new FormData(form);
    const isSaid = ([name, value]) => !lists.includes(name) && (value !== '' || !('withoutEmpty' in form.dataset));
    const texts = [...data].filter(isSaid);
    return JSON.stringify({ ...nested(texts), ...Object.fromEntries(lists.map((name) => [name, data.getAll(name)])) });
  }
  const numbers = [...form.querySelectorAll('input[type=number]')].map((input) => [input.name, input.valueAsNumber]);
  return numbers.length > 0 ? JSON.stringify(Object.fromEntries(numbers)) : undefined;
}

// Values under their names, where `run/label` is the field `label` of `run`, escaped as in a JSON pointer (RFC 6901).
function nested(values) {
  const all = {};
  for (const [name, value] of values) {
    const path = name.split('/').map((part) => part.replaceAll('~1', '/').replaceAll('~0', '~'));
    const last = path.pop();
    const parent = path.reduce((target, part) => (target[part] ??= {}), all);
    parent[last] = value;
  }
  return all;
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
