// A service on which a little of everything has happened.
import { readFileSync } from 'node:fs';

const SUITE = readFileSync(new URL('../farm/still-life.toml', import.meta.url), 'utf8');

// What nobody has: a job that demands it waits.
export const ELSEWHERE = { device: 'gpu', adapter: 'of another world' };

// Where nothing listens: the discard port of this machine.
export const NOBODY = 'http://127.0.0.1:9/hooks/farm';

// Stores the suite; its id.
export async function addSuite(service) {
  return (await service.post('/v1/farm/suites', SUITE, 'application/toml')).id;
}

// Scenes, jobs of every kind and in most states, and a farm with an accepted run and a changed one.
export async function populate(service) {
  const scene = await service.scene('cornell-box');
  const demo = await service.scene('demo');
  const small = { width: 64, height: 48, spp: 2, device: 'cpu' };
  const layers = { ...small, seed: 2, outputs: ['png', 'exr'], aovs: ['depth'] };
  const lineSpace = { acceleration: { line_space: { payload: 'binary', n: 3 } } };
  const benchmark = {
    effects: [{ kind: 'ao', samples: 2 }],
    configurations: [{ name: 'base' }, { name: 'grid', acceleration: { structure: 'grid' } }],
    device: 'cpu', width: 32, height: 24, repetitions: 3, min_sample_s: 0.001, picture_spp: 2,
  };
  const jobs = {
    done: await service.submit(scene, small),
    layers: await service.submit(scene, layers),
    build: await service.submit(scene, lineSpace, 'build'),
    benchmark: await service.submit(scene, benchmark, 'benchmark'),
  };
  const done = await service.succeeded(jobs.done);
  for (const id of [jobs.layers, jobs.build, jobs.benchmark]) await service.succeeded(id);
  jobs.compare = await service.submit(scene, { a: { job: jobs.done }, b: { job: jobs.layers }, max_flip: 0.001 }, 'compare');
  await service.succeeded(jobs.compare);

  const suite = await addSuite(service);
  const accepted = await service.check(suite, 'base', { demo });
  await service.post(`/v1/farm/runs/${accepted}/approve`, { who: 'Ada', why: 'first pictures' });
  const webhook = (await service.post('/v1/farm/webhooks', { url: NOBODY, secret: '0123456789abcdef' })).id;
  const changed = await service.check(suite, 'no bounces', { demo }, { max_bounces: 0 });

  const run = { suite, label: 'nightly', scenes: { demo } };
  await service.post('/v1/farm/schedules', { name: 'nightly', cron: '30 2 * * 1-5', run });
  await service.post('/v1/farm/schedules', { name: 'weekly', cron: '0 6 * * 1', run, paused: true });
  jobs.waiting = await service.submit(scene, ELSEWHERE);
  jobs.cancelled = await service.submit(scene, ELSEWHERE);
  await service.post(`/v1/jobs/${jobs.cancelled}/cancel`, {});
  return { scene, mesh: done.metrics.cache[0].mesh, jobs, runs: { accepted, changed }, webhook };
}

// Every page there is, as name and address.
export function pagesOf({ scene, mesh, jobs, runs, webhook }) {
  return {
    overview: '/',
    jobs: '/jobs',
    'jobs-none': '/jobs?state=failed&q=nothing',
    'job-new': '/jobs/new',
    'job-variation': `/jobs/new?from=${jobs.layers}`,
    job: `/jobs/${jobs.done}`,
    'job-waiting': `/jobs/${jobs.waiting}`,
    'job-cancelled': `/jobs/${jobs.cancelled}`,
    'job-benchmark': `/jobs/${jobs.benchmark}`,
    'job-build': `/jobs/${jobs.build}`,
    'job-compare': `/jobs/${jobs.compare}`,
    'compare-choose': '/compare',
    'compare-one': `/compare?p=${jobs.done}`,
    'compare-side': `/compare?p=${jobs.done}&p=${jobs.layers}&px=9,9`,
    'compare-heat': `/compare?p=${jobs.done}&p=${jobs.layers}&mode=heat`,
    'compare-layer': `/compare?p=${jobs.layers}&p=${jobs.layers}&mode=difference&layer=depth`,
    farm: '/farm',
    'farm-run': `/farm/runs/${runs.accepted}`,
    'farm-run-changed': `/farm/runs/${runs.changed}`,
    'farm-history': '/farm/history?suite=still%20life&case=path',
    'farm-decisions': '/farm/decisions',
    'farm-schedules': '/farm/schedules',
    'farm-webhooks': '/farm/webhooks',
    'farm-webhook': `/farm/webhooks/${webhook}`,
    queue: '/queue',
    benchmarks: '/benchmarks',
    'benchmarks-by': '/benchmarks?by=structure',
    meshes: '/meshes',
    scenes: '/scenes',
    scene: `/scenes/${scene}`,
    mesh: `/meshes/${mesh}`,
    workers: '/workers',
    docs: '/docs',
  };
}
