// Upload of a scene: dropped or chosen files go to `POST /v1/scenes` with a progress bar; what is wrong with them is shown
// field by field.
import { element, notice, problemOf } from './problem.js';

export function startUpload() {
  const form = document.getElementById('upload');
  if (!form) return;
  const drop = document.getElementById('drop');
  for (const id of ['files', 'folder']) {
    const input = document.getElementById(id);
    input.addEventListener('change', () => {
      const files = [...input.files].map((file) => ({ file, path: relativePath(file) }));
      input.value = '';
      upload(files);
    });
  }
  // The whole window takes the drop, so that a near miss does not replace the page by the file.
  addEventListener('dragover', (event) => {
    event.preventDefault();
    drop.classList.add('over');
  });
  addEventListener('dragleave', (event) => {
    if (!event.relatedTarget) drop.classList.remove('over');
  });
  addEventListener('drop', async (event) => {
    event.preventDefault();
    drop.classList.remove('over');
    upload(await droppedFiles(event.dataTransfer));
  });
}

// Path below the chosen folder, as the glTF would name it.
function relativePath(file) {
  const parts = file.webkitRelativePath.split('/');
  return parts.length > 1 ? parts.slice(1).join('/') : file.name;
}

// Files and whole folders.
async function droppedFiles(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (entries.length === 0) return [...transfer.files].map((file) => ({ file, path: file.name }));
  const found = [];
  const prefix = entries.length === 1 && entries[0].isDirectory ? `${entries[0].name}/` : '';
  for (const entry of entries) await walk(entry, entry.name, found);
  return found.map(({ file, path }) => ({ file, path: path.startsWith(prefix) ? path.slice(prefix.length) : path }));
}

async function walk(entry, path, found) {
  if (entry.isFile) {
    const file = await new Promise((resolve, reject) => entry.file(resolve, reject));
    found.push({ file, path });
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    const batch = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (batch.length === 0) return; // it answers in batches until one is empty
    for (const child of batch) await walk(child, `${path}/${child.name}`, found);
  }
}

function upload(files) {
  if (files.length === 0) return;
  const scenes = files.filter(({ path }) => /\.(gltf|glb|zip)$/i.test(path));
  const together = files.some(({ path }) => /\.gltf$/i.test(path));
  if (scenes.length === 0) {
    const detail = 'Choose a .glb, a .zip, or a .gltf together with its buffers and images.';
    show(notice({ title: 'There is no scene among these files', detail, errors: [] }));
  } else if (together || scenes.length === 1) {
    send(together ? files : scenes).then((scene) => scene && location.assign(`/scenes/${encodeURIComponent(scene.id)}`));
  } else {
    sendAll(scenes);
  }
}

// Several scenes, one after another.
async function sendAll(scenes) {
  let failed = false;
  for (const scene of scenes) failed = !(await send([scene])) || failed;
  if (!failed) location.assign('/scenes');
}

function send(files) {
  const name = files.find(({ path }) => /\.(gltf|glb|zip)$/i.test(path)).path;
  const body = new FormData();
  for (const { file, path } of files) body.append('file', file, path);
  const bar = element('progress', '');
  bar.max = 1;
  bar.value = 0;
  bar.setAttribute('aria-label', `Upload of ${name}`);
  const line = element('p', `Uploading ${name}`);
  show(line, bar);
  return new Promise((resolve) => {
    const call = new XMLHttpRequest(); // fetch cannot tell how far an upload is
    call.upload.addEventListener('progress', (event) => {
      if (!event.lengthComputable) return;
      bar.value = event.loaded / event.total;
      if (event.loaded === event.total) line.textContent = `Reading ${name}`;
    });
    call.addEventListener('loadend', () => {
      if (call.status >= 200 && call.status < 300) {
        show(element('p', `${name} is uploaded.`));
        resolve(JSON.parse(call.responseText));
        return;
      }
      const lost = { title: 'The upload did not arrive', detail: 'The connection was lost.', errors: [] };
      show(notice(call.status === 0 ? lost : problemOf(call.status, call.responseText)));
      resolve(null);
    });
    call.open('POST', '/v1/scenes');
    call.send(body);
  });
}

function show(...nodes) {
  document.getElementById('upload-status').replaceChildren(...nodes);
}
