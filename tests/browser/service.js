// A service of its own for a test file: `lightshaft serve` with its worker, on a free port and an empty folder.
import { execFileSync, spawn } from 'node:child_process';
import { closeSync, mkdtempSync, openSync, readFileSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { setTimeout as sleep } from 'node:timers/promises';
import { fileURLToPath } from 'node:url';

const REPOSITORY = fileURLToPath(new URL('../..', import.meta.url));
const TARGET = process.env.CARGO_TARGET_DIR ?? join(REPOSITORY, 'target');
const BINARY = process.env.LIGHTSHAFT_BINARY ?? join(TARGET, 'debug', 'lightshaft');
// Longer than anything here takes on two busy cores.
export const PATIENCE_MS = 120_000;

// Where a run leaves its screenshots.
export const OUTPUT = join(TARGET, 'browser');

export class Service {
  static async start(...options) {
    const service = new Service();
    service.folder = mkdtempSync(join(tmpdir(), 'lightshaft-browser-'));
    const out = join(service.folder, 'serve.out');
    const [stdout, stderr] = [openSync(out, 'w'), openSync(service.path('serve.log'), 'w')];
    const args = ['serve', '--listen', '127.0.0.1:0', '--insecure-local', '--data', service.path('data'), ...options];
    // In a process group of its own, so that its worker ends with it.
    service.child = spawn(BINARY, args, { stdio: ['ignore', stdout, stderr], detached: true });
    service.child.unref();
    [stdout, stderr].forEach(closeSync);
    service.child.on('error', (error) => (service.failure = error));
    // Also where a test process is ended from outside.
    process.on('exit', () => service.kill());
    service.url = await until('serve to listen', () => {
      if (service.failure) throw new Error(`${BINARY} does not start (cargo build --bin lightshaft makes it)`, { cause: service.failure });
      if (service.child.exitCode !== null) throw new Error(`serve ended:\n${service.log()}`);
      return readFileSync(out, 'utf8').match(/^listening on (http:.*)$/m)?.[1];
    });
    return service;
  }

  // A path in the service's folder, outside its data.
  path(name) {
    return join(this.folder, name);
  }

  log() {
    return readFileSync(this.path('serve.log'), 'utf8').split('\n').slice(-60).join('\n');
  }

  stop() {
    this.kill();
    rmSync(this.folder, { recursive: true, force: true, maxRetries: 20 });
  }

  kill() {
    if (this.child.exitCode !== null || this.child.signalCode !== null) return;
    try {
      process.kill(-this.child.pid, 'SIGKILL');
    } catch (error) {
      if (error.code !== 'ESRCH') throw error;
    }
  }

  async get(path) {
    return this.#send(path, {});
  }

  // Sends an object as JSON, or a text or bytes of the media type given.
  async post(path, body, type = 'application/json') {
    const isRaw = typeof body === 'string' || body instanceof Uint8Array;
    return this.#send(path, { method: 'POST', headers: { 'Content-Type': type }, body: isRaw ? body : JSON.stringify(body) });
  }

  async #send(path, options) {
    const response = await fetch(this.url + path, options);
    const text = await response.text();
    if (!response.ok) throw new Error(`${options.method ?? 'GET'} ${path}: ${response.status} ${text}`);
    return text && JSON.parse(text);
  }

  // The file of a generated scene.
  generate(kind, ...options) {
    const file = this.path(`${kind}.glb`);
    execFileSync(BINARY, ['scene', 'generate', kind, ...options, '-o', file]);
    return file;
  }

  // Uploads a generated scene; its id.
  async scene(kind, ...options) {
    return (await this.post('/v1/scenes', readFileSync(this.generate(kind, ...options)), 'model/gltf-binary')).id;
  }

  // Submits a job; its id.
  async submit(scene, settings, kind = 'render') {
    return (await this.post('/v1/jobs', { kind, scene, settings })).id;
  }

  async succeeded(id) {
    const job = await this.settled(`/v1/jobs/${id}`, ['succeeded', 'failed', 'cancelled']);
    if (job.state !== 'succeeded') throw new Error(`job ${id} ${job.state}: ${job.error}`);
    return job;
  }

  // What `path` shows once its state is one of these.
  async settled(path, states) {
    return until(`${path} to be ${states}`, async () => {
      const found = await this.get(path);
      return states.includes(found.state) && found;
    });
  }

  // Runs a suite of the farm to its end; the run's id.
  async check(suite, label, scenes, overrides = {}) {
    const { id } = await this.post('/v1/farm/runs', { suite, label, scenes, overrides });
    await this.settled(`/v1/farm/runs/${id}`, ['finished']);
    return id;
  }
}

// Repeats `probe` until it gives something.
export async function until(what, probe) {
  const start = Date.now();
  while (Date.now() - start < PATIENCE_MS) {
    const found = await probe();
    if (found) return found;
    await sleep(50);
  }
  throw new Error(`waited ${PATIENCE_MS / 1000} s for ${what}`);
}
