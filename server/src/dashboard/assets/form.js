// The form that submits a job. Every field carries the JSON pointer of its value: the request is built from the pointers,
// checked by the service while one types, and what the service says about a pointer appears beside its field.
import { startEnvironment } from './environment.js';
import { hideEstimate, showEstimate } from './estimate.js';
import { element, request } from './problem.js';

const CHECK_AFTER_MS = 300;

export function startForm() {
  const form = document.getElementById('new-job');
  if (!form) return;
  let timer = null;
  let round = 0;
  const key = submissionKey();

  // Whether the form can be submitted; says what stands against it.
  const check = async () => {
    clearTimeout(timer);
    const mine = ++round;
    const body = readForm(form);
    showCurl(form, body);
    try {
      const { tasks, estimate } = await post('/v1/jobs?validate_only=true', body);
      if (mine !== round) return false;
      showEstimate(estimate);
      const isReadable = complaints(form).size === 0;
      if (!isReadable) showProblem(form, { title: 'Some fields cannot be read', errors: [] });
      else showVerdict(form, true, tasks === 1 ? 'Ready to submit.' : `Ready to submit: ${tasks} tasks.`, []);
      return isReadable;
    } catch (problem) {
      if (mine === round) showProblem(form, problem);
      return false;
    }
  };
  const changed = () => {
    showWanted(form);
    clearTimeout(timer);
    timer = setTimeout(check, CHECK_AFTER_MS);
  };

  form.addEventListener('input', changed);
  form.addEventListener('submit', async (event) => {
    event.preventDefault();
    if (form.ariaBusy === 'true') return;
    form.ariaBusy = 'true';
    try {
      if (!(await check())) {
        focusFirstError(form);
        return;
      }
      const body = readForm(form);
      const job = await post('/v1/jobs', body, { 'Idempotency-Key': key.of(body) });
      key.renew();
      location.assign(`/jobs/${encodeURIComponent(job.id)}`);
    } catch (problem) {
      showProblem(form, problem);
      focusFirstError(form);
    } finally {
      form.ariaBusy = null;
    }
  });
  document.getElementById('scene').addEventListener('change', () => loadCameras().then(changed));
  startLights(form, changed);
  startEnvironment(form, changed);
  showWanted(form);
  check();
}

// The same for the same request, until one has been answered: submitting again after a lost answer makes no second job.
function submissionKey() {
  let last = { text: '', key: '' };
  return {
    of(body) {
      const text = JSON.stringify(body);
      if (text !== last.text) last = { text, key: crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}` };
      return last.key;
    },
    renew() {
      last = { text: '', key: '' };
    },
  };
}

function post(address, body, headers = {}) {
  const options = { method: 'POST', headers: { 'Content-Type': 'application/json', ...headers } };
  return request(address, { ...options, body: JSON.stringify(body) });
}

// Fields that belong to another choice are hidden, and not sent.
function showWanted(form) {
  for (const box of form.querySelectorAll('[data-choice]')) {
    const choice = document.getElementById(box.dataset.choice);
    const isOffered = !choice.closest('.field').hidden;
    box.hidden = !isOffered || !box.dataset.wanted.split(' ').includes(choice.value);
  }
}

function readForm(form) {
  const body = { kind: 'render' };
  for (const box of form.querySelectorAll('[data-pointer]')) {
    const control = box.querySelector('[data-value]');
    if (!control || box.hidden || !box.classList.contains('field')) continue;
    const value = valueOf(control);
    if (value !== undefined) put(body, box.dataset.pointer.split('/').slice(1), value);
  }
  return body;
}

// The JSON value of a control; undefined where the default applies.
function valueOf(control) {
  const parts = (selector) => [...control.querySelectorAll(selector)];
  switch (control.dataset.value) {
    case 'number':
      return control.value === '' ? undefined : Number(control.value);
    case 'text':
      return control.value.trim() || undefined;
    case 'choice':
      return control.value === '' || control.value.startsWith('@') ? undefined : JSON.parse(control.value);
    case 'switch':
      return control.checked;
    case 'several':
      return parts(':checked').map((box) => JSON.parse(box.value));
    case 'vector':
      return parts('input').map((input) => Number(input.value)); // what is missing is 0 until it is there
    case 'labels':
      return labelsOf(control.value);
    default:
      return undefined;
  }
}

// What the service cannot say, because it never sees it: what is written in a field, but is no value.
function complaints(form) {
  const found = new Map();
  for (const box of form.querySelectorAll('.field:not([hidden])')) {
    const text = complaint(box.querySelector('[data-value]'));
    if (text) found.set(box, text);
  }
  return found;
}

function complaint(control) {
  switch (control.dataset.value) {
    case 'number':
      return control.validity.badInput ? 'must be a number' : '';
    case 'vector':
      return [...control.querySelectorAll('input')].some((input) => input.value === '') ? 'must be three numbers' : '';
    case 'labels': {
      const wrong = linesOf(control.value).find((line) => line.indexOf('=') < 1);
      return wrong === undefined ? '' : `"${wrong}" must be key=value`;
    }
    default:
      return '';
  }
}

function linesOf(text) {
  return text.split('\n').map((line) => line.trim()).filter(Boolean);
}

function labelsOf(text) {
  const lines = linesOf(text).filter((line) => line.indexOf('=') > 0);
  return Object.fromEntries(lines.map((line) => {
    const at = line.indexOf('=');
    return [line.slice(0, at).trim(), line.slice(at + 1).trim()];
  }));
}

function put(target, path, value) {
  const [key, ...rest] = path;
  if (rest.length === 0) {
    target[key] = value;
    return;
  }
  target[key] ??= /^\d+$/.test(rest[0]) ? [] : {};
  put(target[key], rest, value);
}

function showCurl(form, body) {
  const oneLine = (list) => list.replace(/\s+/g, ' ');
  const json = JSON.stringify(body, null, 2).replace(/\[[-\d.e+,\s]+\]/g, oneLine); // lists of numbers
  const text = json.replaceAll("'", "'\\''");
  document.getElementById('curl').textContent =
    `curl -X POST ${form.dataset.base}/v1/jobs \\\n  -H 'Content-Type: application/json' \\\n  -d '${text}'`;
}

function showVerdict(form, good, text, others) {
  const verdict = document.getElementById('verdict');
  verdict.textContent = text;
  verdict.classList.toggle('good', good);
  verdict.classList.toggle('bad', !good);
  document.getElementById('other-errors').replaceChildren(...others);
  if (good) for (const box of form.querySelectorAll('.field')) setError(box, '');
}

// Every error goes to the field whose pointer is the longest beginning of its own.
function showProblem(form, problem) {
  hideEstimate();
  const own = complaints(form);
  const errors = new Map([...form.querySelectorAll('.field')].map((box) => [box, own.get(box) ?? '']));
  const others = [];
  for (const { pointer, detail } of problem.errors) {
    const box = fieldFor(form, pointer);
    if (own.has(box)) continue;
    if (box) errors.set(box, errors.get(box) ? `${errors.get(box)}; ${detail}` : detail);
    else others.push(errorItem(pointer, detail));
  }
  if (problem.errors.length === 0 && problem.detail) others.push(element('li', problem.detail));
  for (const [box, text] of errors) setError(box, text);
  showVerdict(form, false, problem.title, others);
}

function errorItem(pointer, detail) {
  const item = element('li', '');
  item.append(element('code', pointer), ` ${detail}`);
  return item;
}

function fieldFor(form, pointer) {
  let best = null;
  for (const box of form.querySelectorAll('.field:not([hidden])')) {
    const own = box.dataset.pointer;
    const covers = pointer === own || pointer.startsWith(`${own}/`);
    if (covers && (!best || own.length >= best.dataset.pointer.length)) best = box;
  }
  return best;
}

function setError(box, text) {
  const place = box.querySelector('.field-error');
  const control = box.querySelector('[data-value]');
  if (place.textContent !== text) place.textContent = text;
  if (text) control.setAttribute('aria-invalid', 'true');
  else control.removeAttribute('aria-invalid');
}

// A fieldset cannot have the focus: its first input can.
function focusFirstError(form) {
  const wrong = form.querySelector('[aria-invalid=true]');
  (wrong?.querySelector('input') ?? wrong)?.focus();
}

// The page for the chosen scene knows its cameras.
async function loadCameras() {
  const scene = document.getElementById('scene').value;
  const cameras = document.getElementById('f-settings-camera');
  try {
    const response = await fetch(`/jobs/new?scene=${encodeURIComponent(scene)}`, { headers: { Accept: 'text/html' } });
    const fresh = new DOMParser().parseFromString(await response.text(), 'text/html');
    const options = fresh.getElementById('f-settings-camera').options;
    const kept = cameras.value.startsWith('@') ? cameras.value : '';
    cameras.replaceChildren(...[...options].map((option) => document.importNode(option, true)));
    cameras.value = kept;
    history.replaceState(null, '', `/jobs/new?scene=${encodeURIComponent(scene)}`);
  } catch {
    cameras.value = '';
  }
}

function startLights(form, changed) {
  const list = document.getElementById('lights');
  const blank = document.getElementById('blank-light');
  const template = blank.innerHTML;
  let next = list.querySelectorAll('[data-light]').length;
  document.getElementById('add-light').addEventListener('click', () => {
    const fresh = document.createElement('template');
    fresh.innerHTML = template.replaceAll('__N__', String(next++));
    const light = fresh.content.firstElementChild;
    list.append(light);
    number(list);
    light.querySelector('select').focus();
    changed();
  });
  list.addEventListener('click', (event) => {
    if (!event.target.closest('[data-remove]')) return;
    event.target.closest('[data-light]').remove();
    number(list);
    document.getElementById('add-light').focus();
    changed();
  });
  number(list);
}

// Pointers count from 0 without gaps; ids only have to differ.
function number(list) {
  list.querySelectorAll('[data-light]').forEach((light, index) => {
    light.querySelector('legend').textContent = `Light ${index + 1}`;
    for (const box of light.querySelectorAll('[data-pointer]')) {
      box.dataset.pointer = box.dataset.pointer.replace(/\/lights\/\d+\//, `/lights/${index}/`);
    }
  });
}
