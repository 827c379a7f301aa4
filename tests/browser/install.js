// Fetches the packages of `package-lock.json` into `node_modules` and checks them against its hashes, as
// `npm ci --ignore-scripts` would. For two packages without dependencies this spares the four hundred that Debian's npm needs.

import { execFileSync } from 'node:child_process';
import { createHash } from 'node:crypto';
import { mkdirSync, readFileSync, rmSync } from 'node:fs';
import { basename, dirname, join } from 'node:path';
import { fileURLToPath } from 'node:url';

// As npm knows it, for those who have a mirror.
const registry = process.env.npm_config_registry ?? 'https://registry.npmjs.org/';
const folder = dirname(fileURLToPath(import.meta.url));
const { packages } = JSON.parse(readFileSync(join(folder, 'package-lock.json'), 'utf8'));

rmSync(join(folder, 'node_modules'), { recursive: true, force: true });
for (const [path, { version, integrity }] of Object.entries(packages)) {
  if (path === '') continue;
  const name = path.slice('node_modules/'.length);
  const address = new URL(`${name}/-/${basename(name)}-${version}.tgz`, registry);
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address}: ${answer.status} ${answer.statusText}`);
  const archive = Buffer.from(await answer.arrayBuffer());
  const [algorithm, expected] = integrity.split(/-(.*)/s);
  const found = createHash(algorithm).update(archive).digest('base64');
  if (found !== expected) throw new Error(`${address} has the ${algorithm} ${found}, not ${expected} as in package-lock.json`);
  mkdirSync(join(folder, path), { recursive: true });
  execFileSync('tar', ['-xz', '--strip-components=1', '-C', join(folder, path)], { input: archive });
}
