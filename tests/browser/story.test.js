// The whole story, as somebody tells it to the browser: upload, submit, watch, compare, approve.
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './browser.js';
import { Service } from './service.js';
import { addSuite, ELSEWHERE, NOBODY } from './world.js';

let browser;
let service;
before(async () => {
  browser = await Browser.open('story');
  service = await Service.start('--device', 'cpu', '--device-grace-s', '3600');
});
after(async () => {
  await browser?.close();
  service?.stop();
});

// Sets fields of the form by the pointers of their values, submits it, and waits for the job's picture; the job's id.
async function render(tab, settings) {
  for (const [name, value] of Object.entries(settings)) {
    await tab.fill(`[data-pointer="/settings/${name}"] input`, String(value));
  }
  await tab.waitForFunction(() => document.getElementById('verdict').textContent.startsWith('Ready to submit'));
  await tab.getByRole('button', { name: 'Submit' }).click();
  await tab.waitForURL(/\/jobs\/(?!new)/);
  await tab.waitForFunction(() => {
    const picture = document.querySelector('#picture[src*="image.png"]');
    return document.getElementById('state').innerText === 'succeeded' && picture?.complete && picture.naturalWidth > 0;
  });
  return new URL(tab.url()).pathname.split('/').at(-1);
}

test('somebody uploads, submits, watches, compares and approves', async () => {
  const tab = await browser.tab(service.url);
  await tab.goto(service.url);
  await tab.keyboard.press('?');
  await tab.waitForSelector('#keys[open]');
  await browser.keep(tab, '0-keys');
  await tab.keyboard.press('Escape');
  await tab.waitForSelector('#keys', { state: 'hidden' });
  await tab.keyboard.press('g');
  await tab.keyboard.press('s');
  await tab.waitForURL(/\/scenes$/);
  await tab.setInputFiles('#files', service.generate('cornell-box'));
  await tab.waitForURL(/\/scenes\/.+/);
  assert.equal(await tab.innerText('h1'), 'cornell-box');
  await tab.waitForFunction(() => document.querySelector('main img')?.naturalWidth > 0);
  await browser.keep(tab, '1-uploaded');

  await tab.getByRole('link', { name: 'Render this' }).click();
  await tab.waitForSelector('#new-job');
  const first = await render(tab, { width: 96, height: 72, spp: 4 });
  assert.equal(await tab.evaluate(() => document.getElementById('picture').naturalWidth), 96);
  assert.match(await tab.innerText('#metrics'), /MRays\/s/);
  await browser.keep(tab, '2-rendered');
  await tab.getByRole('link', { name: 'Submit a variation' }).click();
  await tab.waitForSelector('#new-job');
  await tab.waitForFunction(() => /about .* of this scene .* MRays/.test(document.querySelector('#estimate [data-time]').textContent));
  assert.match(await tab.innerText('#estimate [data-memory]'), /^about .* picture 108 KiB$/);
  const second = await render(tab, { seed: 7 });

  await tab.goto(`${service.url}/jobs`);
  for (const job of [first, second]) await tab.check(`[name=p][value="${job}"]`);
  await tab.getByRole('button', { name: 'Compare selected' }).click();
  await tab.waitForURL(/\/compare\?/);
  for (const [key, mode] of [['s', 'side'], ['w', 'swipe'], ['d', 'difference'], ['h', 'heat']]) {
    await tab.focus('.stage');
    await tab.keyboard.press(key);
    await tab.waitForFunction((wanted) => {
      const root = document.querySelector('[data-compare]');
      const chosen = document.querySelector('#compare-bar [name=mode]:checked').value;
      return chosen === wanted && root.querySelector('[data-busy]').hidden && root.querySelector('[data-figures]').innerText.includes('RMSE');
    }, mode);
    await browser.keep(tab, `3-compared-${mode}`);
  }
  for (const key of ['Shift+ArrowRight', 'c', 'Shift+ArrowRight', 'Shift+ArrowDown', 'c']) await tab.keyboard.press(key);
  await tab.waitForSelector('[data-crop]:not([hidden])');
  await tab.waitForURL(/crop=\d+,\d+,2,2/);

  await judge(tab);
  assert.deepEqual(tab.wrongs, []);
});

// A run of the farm whose pictures changed is looked at and approved.
async function judge(tab) {
  const demo = await service.scene('demo');
  const suite = await addSuite(service);
  const base = await service.check(suite, 'base', { demo });
  await service.post(`/v1/farm/runs/${base}/approve`, { who: 'Ada', why: 'first pictures' });
  const changed = await service.check(suite, 'no bounces', { demo }, { max_bounces: 0 });

  await tab.goto(service.url);
  await tab.getByRole('link', { name: 'still life at no bounces' }).click();
  await tab.waitForURL(new RegExp(`/farm/runs/${changed}`));
  await tab.waitForFunction(() => document.querySelector('#case-path .frame + .frame img')?.naturalWidth > 0);
  assert.equal(await tab.locator('.case').count(), 1, 'occlusion has no bounces');
  await browser.keep(tab, '4-changed');
  await tab.fill('#decide [name=who]', 'Grace');
  await tab.fill('#decide [name=why]', 'bounces are gone on purpose');
  await tab.check('#case-path [name=cases]');
  await tab.getByRole('button', { name: 'Approve chosen' }).click();
  await tab.waitForFunction(() => document.getElementById('state').innerText === 'Ok');
  await browser.keep(tab, '5-approved');
  const run = await service.get(`/v1/farm/runs/${changed}`);
  assert.deepEqual([run.ok, run.cases.find((found) => found.name === 'path').decision.who], [true, 'Grace']);
}

test('waiting jobs are raised and cancelled, and runs are scheduled', async () => {
  const tab = await browser.tab(service.url);
  await addSuite(service);
  await service.scene('demo');
  const scene = await service.scene('furnace-sphere');
  const [first, second] = [await service.submit(scene, ELSEWHERE), await service.submit(scene, ELSEWHERE)];
  await tab.goto(`${service.url}/queue`);
  const waiting = (ids) => tab.waitForFunction((wanted) => [...document.querySelectorAll('.turn')].map((turn) => turn.id).join() === wanted, ids.map((id) => `turn-${id}`).join());
  // The scene's thumbnail is rendered, and leaves the queue.
  await waiting([first, second]);
  await tab.locator(`#turn-${second}`).getByRole('button', { name: 'Raise' }).click();
  await waiting([second, first]);
  assert.equal((await service.get(`/v1/jobs/${second}`)).priority, 10);
  await browser.keep(tab, '6-queue');
  await tab.locator(`#turn-${second}`).getByRole('button', { name: 'Cancel' }).click();
  await waiting([first]);
  await service.settled(`/v1/jobs/${second}`, ['cancelled']);

  await tab.goto(`${service.url}/farm/schedules`);
  for (const [name, value] of [['name', 'nightly'], ['cron', 'never'], ['run/label', 'nightly']]) await tab.fill(`#add-schedule [name="${name}"]`, value);
  await tab.getByRole('button', { name: 'Add', exact: true }).click();
  await tab.waitForFunction(() => document.getElementById('alerts').innerText.includes('/cron'));
  await tab.fill('#add-schedule [name="cron"]', '30 2 * * 1-5');
  await tab.getByRole('button', { name: 'Add', exact: true }).click();
  await tab.waitForFunction(() => document.getElementById('schedules').innerText.includes('30 2 * * 1-5'));
  const [schedule] = (await service.get('/v1/farm/schedules')).items;
  assert.deepEqual([schedule.run.baseline, Object.keys(schedule.run.scenes)], ['main', ['demo']]);
  await browser.keep(tab, '7-scheduled');
  await tab.getByRole('button', { name: 'Pause nightly' }).click();
  await tab.getByRole('button', { name: 'Resume nightly' }).waitFor();
  assert.deepEqual((await service.get('/v1/farm/schedules')).items.map(({ paused, next_at }) => [paused, next_at]), [[true, null]]);
  tab.once('dialog', (dialog) => dialog.accept());
  await tab.getByRole('button', { name: 'Delete nightly' }).click();
  await tab.waitForFunction(() => document.getElementById('schedules').innerText.includes('Nothing is scheduled'));
  // The pattern that is none was refused on purpose.
  assert.deepEqual(tab.wrongs.filter((wrong) => !wrong.includes('/v1/farm/schedules')), []);
});

test('a webhook is added, its message is followed and sent again', async () => {
  const tab = await browser.tab(service.url);
  await tab.goto(`${service.url}/farm/webhooks`);
  await tab.fill('#add-webhook [name=url]', NOBODY);
  await tab.fill('#add-webhook [name=secret]', '0123456789abcdef');
  await tab.getByLabel('run.finished').check();
  await tab.getByRole('button', { name: 'Add', exact: true }).click();
  await tab.locator('#webhooks').getByRole('link', { name: NOBODY }).waitFor();
  const [webhook] = (await service.get('/v1/farm/webhooks')).items;
  assert.deepEqual([webhook.events, webhook.suite], [['run.finished'], null]);

  const demo = await service.scene('demo');
  await service.check(await addSuite(service), 'told', { demo });
  await tab.locator('#webhooks').getByRole('link', { name: NOBODY }).click();
  const attempts = (count) => tab.waitForFunction((wanted) => document.querySelectorAll('#deliveries .sends li').length === wanted, count);
  await attempts(1);
  await tab.getByText('JSON').click();
  assert.match(await tab.innerText('#deliveries pre'), /"type": "run.finished"/);
  await browser.keep(tab, '8-webhook');
  await tab.getByRole('button', { name: 'Resend' }).click();
  await attempts(2);
  assert.deepEqual(tab.wrongs, []);
});
