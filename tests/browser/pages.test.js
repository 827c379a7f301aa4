// Every page: whole, usable by everybody on every screen, without an error, and from this host alone.
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { Browser } from './browser.js';
import { Service } from './service.js';
import { pagesOf, populate } from './world.js';

let browser;
before(async () => (browser = await Browser.open('pages')));
after(() => browser?.close());

// Opens a page and waits until all of it is there.
async function open(tab, service, address) {
  await tab.goto(service.url + address);
  await tab.waitForSelector('h1');
  // Pictures and values of the comparison, the log of a job, and the verdict on a form come later.
  await tab.waitForFunction(() => {
    const compare = document.querySelector('[data-compare]');
    const late = [...document.querySelectorAll('#log, #verdict')];
    return (!compare || 'ready' in compare.dataset) && !late.some((element) => /^(Loading|Checking)/.test(element.textContent));
  });
}

async function auditAll(service, pages, check = () => {}) {
  const tab = await browser.tab(service.url);
  const wrongs = [];
  for (const [name, address] of Object.entries(pages)) {
    await open(tab, service, address);
    wrongs.push(...(await browser.audit(tab, name)), ...tab.wrongs.splice(0).map((wrong) => `${name}: ${wrong}`));
    await check(tab, name);
  }
  await tab.close();
  assert.deepEqual(wrongs, []);
}

test('every page is for everybody on every screen', async () => {
  const service = await Service.start('--device', 'cpu', '--device-grace-s', '3600');
  try {
    await auditAll(service, pagesOf(await populate(service)));
  } finally {
    service.stop();
  }
});

test('an empty service shows how to begin, and a page says what is not there', async () => {
  const service = await Service.start('--workers', '0');
  const empty = {
    'empty-overview': '/', 'empty-jobs': '/jobs', 'empty-job-new': '/jobs/new', 'empty-compare': '/compare',
    'empty-farm': '/farm', 'empty-decisions': '/farm/decisions', 'empty-schedules': '/farm/schedules', 'empty-webhooks': '/farm/webhooks',
    'empty-queue': '/queue', 'empty-benchmarks': '/benchmarks', 'empty-scenes': '/scenes', 'empty-meshes': '/meshes',
    'empty-workers': '/workers',
  };
  const missing = {
    '/nowhere': 'Nothing lives at /nowhere.',
    '/jobs/nope': 'there is no job',
    '/scenes/nope': 'there is no scene',
    '/meshes/nope': 'there is no mesh',
    '/compare?p=nope': 'there is no job',
    '/farm/webhooks/nope': 'there is no webhook',
    '/jobs/new?from=nope': 'there is no job',
    '/jobs?state=dreaming': 'must be queued, running, succeeded, failed or cancelled',
  };
  try {
    await auditAll(service, empty, async (tab, name) => {
      if (name !== 'empty-overview') return;
      const text = await tab.innerText('body');
      assert.match(text, new RegExp(`curl -F file=@scene.glb ${service.url}/v1/scenes`));
      assert.match(text, new RegExp(`lightshaft worker --server ${service.url}`));
    });
    const tab = await browser.tab(service.url);
    for (const [address, said] of Object.entries(missing)) {
      await open(tab, service, address);
      assert.ok((await tab.innerText('body')).includes(said), `${address} says: ${await tab.innerText('body')}`);
    }
    assert.deepEqual([...(await browser.audit(tab, 'missing')), ...tab.wrongs], []);
    await tab.getByRole('link', { name: 'To the overview' }).click();
    await tab.waitForURL(`${service.url}/`);
  } finally {
    service.stop();
  }
});

test('the audit finds what is wrong', async () => {
  const tab = await browser.tab('http://127.0.0.1:1');
  await tab.setContent(`<!doctype html><html lang="en"><title>Wrong</title><main><h1>Wrong</h1>
    <p style="color: #777; background: #888">faint</p><button style="width: 900px"></button>
    <img alt="" src="http://elsewhere.invalid/pixel.png"><script>throw new Error('on purpose')</script></main>`);
  const found = [...(await browser.audit(tab, 'wrong')), ...tab.wrongs].join('\n');
  for (const wrong of [
    'wrong, light: serious: Elements must meet minimum color contrast', 'wrong, dark: serious: Elements must meet minimum color contrast',
    'critical: Buttons must have discernible text', 'wrong, phone: scrolls sideways', 'asks for http://elsewhere.invalid', 'on purpose',
  ]) assert.ok(found.includes(wrong), `${wrong} is not among\n${found}`);
});
