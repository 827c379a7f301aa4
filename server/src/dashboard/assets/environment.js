// An environment map goes to the blob store first; its hash is the setting. It is chosen, or dropped on the form.
import { notice, request } from './problem.js';

export function startEnvironment(form, changed) {
  const input = document.getElementById('environment-file');
  if (!input) return;
  input.addEventListener('change', async () => {
    await upload(input, input.files[0], changed);
    input.value = '';
  });
  form.addEventListener('dragover', (event) => event.preventDefault());
  form.addEventListener('drop', (event) => {
    event.preventDefault();
    const file = event.dataTransfer.files[0];
    if (!file) return;
    const sky = document.getElementById(input.closest('[data-choice]').dataset.choice);
    sky.value = '@map';
    sky.dispatchEvent(new Event('input', { bubbles: true }));
    upload(input, file, changed);
  });
}

async function upload(input, file, changed) {
  const target = document.getElementById(input.dataset.fills);
  const status = document.getElementById('environment-status');
  if (!/\.(hdr|exr)$/i.test(file.name)) {
    status.replaceChildren(notice({ title: `${file.name} is not a map`, detail: 'Choose an .hdr or .exr file.', errors: [] }));
    return;
  }
  status.textContent = `Uploading ${file.name}…`;
  try {
    const { hash } = await request('/v1/blobs', { method: 'POST', body: file });
    target.value = hash;
    status.textContent = `${file.name} is uploaded.`;
    changed();
  } catch (problem) {
    status.replaceChildren(notice(problem));
  }
}
